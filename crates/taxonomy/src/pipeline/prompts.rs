//! The prompts: what is asked in which stage, in our own words, with every hole filled from the plan.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use super::backend::{Call, CallStage, Input, Sampling};
use super::error::PipelineError;
use super::plan::{DatabasePlan, TopicPlan, hash};
use super::template::{Variables, render};
use crate::utterance::Cell;
use crate::words;

/// Sentences of a cell that a prompt shows as already there.
const MAX_AVOID: usize = 5;

/// The prompt templates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Prompts {
    system: String,
    summarise: String,
    generate: String,
    rate_joint: String,
    rate_prefix: String,
}

impl Default for Prompts {
    fn default() -> Self {
        Self {
            system: include_str!("../../prompts/system.txt").trim().to_owned(),
            summarise: include_str!("../../prompts/summarise.txt").to_owned(),
            generate: include_str!("../../prompts/generate.txt").to_owned(),
            rate_joint: include_str!("../../prompts/rate_joint.txt").to_owned(),
            rate_prefix: include_str!("../../prompts/rate_prefix.txt").to_owned(),
        }
    }
}

impl Prompts {
    /// Reads templates from a directory; those that it lacks are the built-in ones.
    ///
    /// # Errors
    ///
    /// [`PipelineError::File`] if one is there and cannot be read.
    pub fn from_directory(directory: &Path) -> Result<Self, PipelineError> {
        let mut prompts = Self::default();
        let files = [
            ("system.txt", &mut prompts.system),
            ("summarise.txt", &mut prompts.summarise),
            ("generate.txt", &mut prompts.generate),
            ("rate_joint.txt", &mut prompts.rate_joint),
            ("rate_prefix.txt", &mut prompts.rate_prefix),
        ];
        for (name, template) in files {
            let path = directory.join(name);
            if path.exists() {
                *template = std::fs::read_to_string(&path).map_err(PipelineError::file(&path))?;
            }
        }
        Ok(prompts)
    }
}

/// Writes the calls of a run.
#[derive(Clone, Debug)]
pub struct PromptWriter<'a> {
    plan: &'a DatabasePlan,
    prompts: &'a Prompts,
}

impl<'a> PromptWriter<'a> {
    /// Puts a plan and its prompts together.
    pub fn new(plan: &'a DatabasePlan, prompts: &'a Prompts) -> Self {
        Self { plan, prompts }
    }

    /// Fills every template once, so that a wrong one is told before anybody is asked.
    ///
    /// # Errors
    ///
    /// [`PipelineError`] naming the template and what is wrong with it.
    pub fn check(&self) -> Result<(), PipelineError> {
        self.summarise()?;
        for topic in &self.plan.topic {
            self.generate("", topic, Cell::new(1, 1), 0, &[])?;
            self.rate_joint(topic, "", 0)?;
            self.rate_prefix(topic, "", 0, 0)?;
        }
        Ok(())
    }

    /// Asks what in the domain matters.
    ///
    /// # Errors
    ///
    /// [`PipelineError`] if the template is wrong.
    pub fn summarise(&self) -> Result<Call, PipelineError> {
        let mut variables = self.common();
        variables.insert("world", self.plan.world.trim().to_owned());
        variables.insert("missing", self.plan.missing.trim().to_owned());
        let prompt = render("summarise", &self.prompts.summarise, &variables)?;
        self.call(CallStage::Summarise, prompt, 0.0, 0, Input::Domain)
    }

    /// Asks for sentences.
    ///
    /// # Errors
    ///
    /// [`PipelineError`] if the template is wrong.
    pub fn generate(
        &self,
        summary: &str,
        topic: &TopicPlan,
        cell: Cell,
        round: u32,
        accepted: &[String],
    ) -> Result<Call, PipelineError> {
        let settings = &self.plan.settings;
        let mut variables = self.common();
        let recent = accepted.len().saturating_sub(MAX_AVOID);
        variables.insert("summary", summary.trim().to_owned());
        variables.insert("topic", topic.id.clone());
        variables.insert("action", topic.action.clone());
        variables.insert("n", settings.batch.to_string());
        variables.insert("k", cell.comprehension.to_string());
        variables.insert("l", cell.conveyance.to_string());
        variables.insert("order", order(cell).to_owned());
        variables.insert("examples", self.plan.examples.join("\n"));
        let avoid =
            if accepted.is_empty() { "(none)".to_owned() } else { accepted[recent..].join("\n") };
        variables.insert("avoid", avoid);
        let prompt = render("generate", &self.prompts.generate, &variables)?;
        let seed = derive(settings.seed, &(&self.plan.domain, "generate", &topic.id, cell, round));
        let input = Input::Sentences { topic: topic.id.clone(), cell, n: settings.batch, round };
        self.call(CallStage::Generate, prompt, settings.temperature, seed, input)
    }

    /// Asks for one percentage per word of a sentence.
    ///
    /// # Errors
    ///
    /// [`PipelineError`] if the template is wrong.
    pub fn rate_joint(
        &self,
        topic: &TopicPlan,
        text: &str,
        attempt: u32,
    ) -> Result<Call, PipelineError> {
        let mut variables = self.common();
        variables.insert("topic", topic.id.clone());
        variables.insert("action", topic.action.clone());
        variables.insert("text", text.to_owned());
        variables.insert("rated", rated(topic));
        let prompt = render("rate_joint", &self.prompts.rate_joint, &variables)?;
        self.rating(topic, text, None, prompt, attempt)
    }

    /// Asks for the percentage after the first words of a sentence, the others hidden.
    ///
    /// # Errors
    ///
    /// [`PipelineError`] if the template is wrong.
    pub fn rate_prefix(
        &self,
        topic: &TopicPlan,
        text: &str,
        n_words: usize,
        attempt: u32,
    ) -> Result<Call, PipelineError> {
        let mut variables = self.common();
        variables.insert("topic", topic.id.clone());
        variables.insert("action", topic.action.clone());
        variables.insert("prefix", words::prefix(text, n_words));
        variables.insert("rated_prefixes", rated_prefixes(topic));
        let prompt = render("rate_prefix", &self.prompts.rate_prefix, &variables)?;
        self.rating(topic, text, Some(n_words), prompt, attempt)
    }

    fn rating(
        &self,
        topic: &TopicPlan,
        text: &str,
        words: Option<usize>,
        prompt: String,
        attempt: u32,
    ) -> Result<Call, PipelineError> {
        // The first single rating is the likeliest one; repeats and second tries must differ to be of use.
        let drawn = attempt > 0 || self.plan.settings.repeats > 1;
        let temperature = if drawn { 0.7 } else { 0.0 };
        let seed = self.plan.settings.seed;
        let seed = derive(seed, &(&self.plan.domain, "rate", &topic.id, text, words, attempt));
        let input = Input::Sentence { topic: topic.id.clone(), text: text.to_owned(), words };
        self.call(CallStage::Rate, prompt, temperature, seed, input)
    }

    fn call(
        &self,
        stage: CallStage,
        prompt: String,
        temperature: f64,
        seed: u64,
        input: Input,
    ) -> Result<Call, PipelineError> {
        let settings = &self.plan.settings;
        let (top_p, max_tokens) = (settings.top_p, settings.max_tokens);
        let sampling = Sampling { temperature, top_p, max_tokens };
        let system = render("system", &self.prompts.system, &self.common())?;
        Ok(Call { stage, system, prompt, sampling, seed, input })
    }

    fn common(&self) -> Variables {
        let actions: Vec<String> =
            self.plan.topic.iter().map(|topic| format!("- {}", topic.action)).collect();
        BTreeMap::from([("role", self.plan.role.clone()), ("actions", actions.join("\n"))])
    }
}

/// Tells where the directive should stand. Naming a number alone leaves the late cells empty.
fn order(cell: Cell) -> &'static str {
    if cell.comprehension == cell.conveyance {
        "begin with the reason or with a form of address, and say what to do with the very last words"
    } else if cell.comprehension == 2 {
        "say what to do with the first two words, and how or why after that"
    } else {
        "say a word or two of warning or manner first, then what to do, then the rest"
    }
}

fn rated(topic: &TopicPlan) -> String {
    let mut out = String::from("Two ratings as they should look:");
    for rated in &topic.rated {
        let words: Vec<&str> = rated.text.split_whitespace().collect();
        let curve: Vec<String> = rated.curve.iter().map(u8::to_string).collect();
        // Writing to a string cannot fail.
        let _written = write!(
            out,
            "\nInstruction: {}\nWords: {}\nComprehension after each word: {}\n",
            rated.text,
            words.join(" | "),
            curve.join(", ")
        );
    }
    out.trim_end().to_owned()
}

fn rated_prefixes(topic: &TopicPlan) -> String {
    let mut out = String::from("Answers as they should look:");
    for rated in &topic.rated {
        for (i, percent) in rated.curve.iter().enumerate() {
            let prefix = words::prefix(&rated.text, i + 1);
            // Writing to a string cannot fail.
            let _written = write!(out, "\nHeard so far: \"{prefix}\" -> {percent}");
        }
    }
    out
}

/// Derives a seed from a run's and from what it is for; below 2^53, because some servers read numbers as doubles.
fn derive(seed: u64, what: &impl serde::Serialize) -> u64 {
    let text = serde_json::to_string(&(seed, what)).unwrap_or_default();
    u64::from_str_radix(&hash(text.as_bytes())[..13], 16).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::job;

    #[test]
    fn every_built_in_prompt_can_be_filled() {
        let plan = job::plan("highway").unwrap();
        let prompts = Prompts::default();
        let writer = PromptWriter::new(&plan, &prompts);
        let topic = &plan.topic[0];
        let accepted: Vec<String> = (0..7).map(|i| format!("sentence {i}")).collect();
        let call = writer.generate("SUMMARY", topic, Cell::new(2, 4), 3, &accepted).unwrap();
        assert!(call.prompt.contains("exactly 4 words") && call.prompt.contains("SUMMARY"));
        assert!(call.prompt.contains("sentence 6") && !call.prompt.contains("sentence 1\n"));
        assert!(call.seed < 1 << 53);
        let again = writer.generate("SUMMARY", topic, Cell::new(2, 4), 4, &accepted).unwrap();
        assert_ne!(call.seed, again.seed);
        assert!(writer.summarise().unwrap().prompt.contains("merge"));
        let joint = writer.rate_joint(topic, "Slow down now.", 0).unwrap();
        assert!(joint.prompt.ends_with("Instruction: Slow down now.\n"));
        assert_eq!(joint.sampling.temperature, 0.0);
        assert!(writer.rate_joint(topic, "Slow down now.", 1).unwrap().sampling.temperature > 0.0);
    }

    #[test]
    fn a_prefix_call_does_not_see_later_words() {
        let plan = job::plan("highway").unwrap();
        let prompts = Prompts::default();
        let writer = PromptWriter::new(&plan, &prompts);
        let call = writer.rate_prefix(&plan.topic[0], "Zebra slow down.", 1, 0).unwrap();
        assert!(call.prompt.contains("Heard so far: \"Zebra\"\n"));
        assert!(!call.prompt.contains("Zebra slow"));
    }

    #[test]
    fn a_template_of_ones_own_with_an_unknown_variable_is_named() {
        let directory = tempfile::tempdir().unwrap();
        std::fs::write(directory.path().join("generate.txt"), "Say {{topik}}").unwrap();
        let prompts = Prompts::from_directory(directory.path()).unwrap();
        let plan = job::plan("highway").unwrap();
        let writer = PromptWriter::new(&plan, &prompts);
        let error = writer.generate("", &plan.topic[0], Cell::new(2, 2), 0, &[]).unwrap_err();
        let says =
            "prompt template `generate` has the unknown variable `topik`; known: action, actions";
        assert!(error.to_string().starts_with(says), "{error}");
    }
}

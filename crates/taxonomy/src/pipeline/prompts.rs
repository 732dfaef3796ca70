//! The prompts: what is asked in which stage, in our own words, with every hole filled from the plan.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use super::backend::{Call, CallStage, Input, Sampling};
use super::error::PipelineError;
use super::plan::{DatabasePlan, RatedSentence, TopicPlan, hash};
use super::regular;
use super::reply::joined;
use super::template::{Variables, render};
use crate::utterance::Cell;
use crate::words;

/// Sentences of a cell that a prompt shows as already there.
const MAX_AVOID: usize = 5;

/// The built-in templates, by name.
const BUILT_IN: [(&str, &str); 5] = [
    ("system", include_str!("../../prompts/system.txt").trim_ascii()),
    ("summarise", include_str!("../../prompts/summarise.txt")),
    ("generate", include_str!("../../prompts/generate.txt")),
    ("rate_joint", include_str!("../../prompts/rate_joint.txt")),
    ("rate_prefix", include_str!("../../prompts/rate_prefix.txt")),
];

/// The prompt templates, by name.
#[derive(Debug)]
pub(super) struct Prompts(BTreeMap<&'static str, String>);

impl Default for Prompts {
    fn default() -> Self {
        Self(BUILT_IN.iter().map(|(name, template)| (*name, (*template).to_owned())).collect())
    }
}

impl Prompts {
    /// Reads templates from a directory; those that it lacks are the built-in ones.
    pub(super) fn from_directory(directory: &Path) -> Result<Self, PipelineError> {
        let mut prompts = Self::default();
        for (name, template) in &mut prompts.0 {
            let path = directory.join(name).with_extension("txt");
            if path.exists() {
                *template = regular::read_to_string(&path)?;
            }
        }
        Ok(prompts)
    }

    fn render(&self, name: &str, variables: &Variables) -> Result<String, PipelineError> {
        render(name, &self.0[name], variables)
    }
}

/// Writes the calls of a run; an error says what is wrong with a template.
#[derive(Debug)]
pub(super) struct PromptWriter<'a> {
    pub(super) plan: &'a DatabasePlan,
    pub(super) prompts: &'a Prompts,
}

impl PromptWriter<'_> {
    /// Fills every template once, so that a wrong one is reported before any model is asked.
    pub(super) fn check(&self) -> Result<(), PipelineError> {
        self.summarise()?;
        for topic in &self.plan.topic {
            self.generate("", topic, Cell::new(1, 1), 0, &[])?;
            self.rate_joint(topic, "", 0)?;
            self.rate_prefix(topic, "", 0, 0)?;
        }
        Ok(())
    }

    /// Asks what in the domain matters.
    pub(super) fn summarise(&self) -> Result<Call, PipelineError> {
        let mut variables = self.common();
        variables.insert("world", self.plan.world.trim().to_owned());
        variables.insert("missing", self.plan.missing.trim().to_owned());
        let prompt = self.prompts.render("summarise", &variables)?;
        self.call(CallStage::Summarise, prompt, 0.0, 0, Input::Domain)
    }

    /// Asks for further sentences of one cell; the latest accepted ones are shown, to be avoided.
    pub(super) fn generate(
        &self,
        summary: &str,
        topic: &TopicPlan,
        cell: Cell,
        round: u32,
        accepted: &[String],
    ) -> Result<Call, PipelineError> {
        let settings = &self.plan.settings;
        let recent = &accepted[accepted.len().saturating_sub(MAX_AVOID)..];
        let avoid = if recent.is_empty() { "(none)".to_owned() } else { recent.join("\n") };
        let mut variables = self.about(topic);
        variables.extend([
            ("summary", summary.trim().to_owned()),
            ("n", settings.batch.to_string()),
            ("k", cell.comprehension.to_string()),
            ("l", cell.conveyance.to_string()),
            ("order", order(cell).to_owned()),
            ("examples", self.plan.examples.join("\n")),
            ("avoid", avoid),
        ]);
        let prompt = self.prompts.render("generate", &variables)?;
        let seed = derive(settings.seed, &(&self.plan.domain, "generate", &topic.id, cell, round));
        let input = Input::Sentences { topic: topic.id.clone(), cell, n: settings.batch, round };
        self.call(CallStage::Generate, prompt, settings.temperature, seed, input)
    }

    /// Asks for one percentage per word of a sentence.
    pub(super) fn rate_joint(
        &self,
        topic: &TopicPlan,
        text: &str,
        attempt: u32,
    ) -> Result<Call, PipelineError> {
        let mut variables = self.about(topic);
        variables.insert("text", text.to_owned());
        variables.insert("rated", rated(topic));
        let prompt = self.prompts.render("rate_joint", &variables)?;
        self.rating(topic, text, None, prompt, attempt)
    }

    /// Asks for the percentage after the first words of a sentence, the others hidden.
    pub(super) fn rate_prefix(
        &self,
        topic: &TopicPlan,
        text: &str,
        n_words: usize,
        attempt: u32,
    ) -> Result<Call, PipelineError> {
        let mut variables = self.about(topic);
        variables.insert("prefix", words::prefix(text, n_words));
        variables.insert("rated_prefixes", rated_prefixes(topic));
        let prompt = self.prompts.render("rate_prefix", &variables)?;
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
        let system = self.prompts.render("system", &self.common())?;
        Ok(Call { stage, system, prompt, sampling, seed, input })
    }

    fn common(&self) -> Variables {
        let actions: Vec<String> =
            self.plan.topic.iter().map(|topic| format!("- {}", topic.action)).collect();
        BTreeMap::from([("role", self.plan.role.clone()), ("actions", actions.join("\n"))])
    }

    fn about(&self, topic: &TopicPlan) -> Variables {
        let mut variables = self.common();
        variables.insert("topic", topic.id.clone());
        variables.insert("action", topic.action.clone());
        variables
    }
}

/// Says where the directive should stand. Naming a number alone leaves the late cells empty.
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
    let example = |rated: &RatedSentence| {
        let words: Vec<&str> = rated.text.split_whitespace().collect();
        let (words, curve) = (words.join(" | "), joined(&rated.curve));
        let text = &rated.text;
        format!("\nInstruction: {text}\nWords: {words}\nComprehension after each word: {curve}\n")
    };
    let examples: String = topic.rated.iter().map(example).collect();
    format!("Two ratings as they should look:{}", examples.trim_end())
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
        let writer = PromptWriter { plan: &plan, prompts: &prompts };
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
        let writer = PromptWriter { plan: &plan, prompts: &prompts };
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
        let writer = PromptWriter { plan: &plan, prompts: &prompts };
        let error = writer.generate("", &plan.topic[0], Cell::new(2, 2), 0, &[]).unwrap_err();
        let says =
            "prompt template `generate` has the unknown variable `topik`; known: action, actions";
        assert!(error.to_string().starts_with(says), "{error}");
    }
}

//! What a client asks for a session with, and what it is answered.

use leadtime_proto::Incarnation;
use leadtime_proto::phrase::counted;
use leadtime_proto::text::quoted;
use leadtime_sims::{Fact, Quantity};
use leadtime_voice::VoiceBook;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use thiserror::Error;

use crate::json_fault::{
    FieldRule, JsonFault, no_choice, no_count, no_number, no_small_count, no_text, or_null,
};
use crate::observation::brief;
use crate::robot::ObservationSource;
use crate::working_policy::{PolicyOrigin, WorkingPolicy, told_voice};

/// The version of the messages between a notifier at work and its clients.
pub const LIVE_PROTOCOL: u32 = 1;
/// How the refusal of a client of another task begins.
pub const WRONG_TASK: &str = "this notifier is for ";
/// The longest step, in seconds.
pub const MAX_STEP: f64 = 5.0;
/// The longest patience with a client that says nothing, in seconds.
const MAX_PATIENCE: f64 = 600.0;
/// The pace of words, in seconds.
const STEP: f64 = 0.3;
/// How old observations may be, and when a client counts as lost, where steps are taken by the clock, in seconds.
const TIMED_PATIENCE: (f64, f64) = (0.5, 1.0);
/// The same where every observation is a step, in seconds: a simulator may think.
const STEPPED_PATIENCE: (f64, f64) = (10.0, 30.0);

/// When a step is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StepClock {
    /// Every `seconds_per_step`, on the newest observation.
    #[default]
    Timer,
    /// With every observation: for simulators.
    Observation,
    /// Where a word ends, by the client's reports or the voice; without either as [`StepClock::Timer`].
    Word,
}

/// How long a word takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WordClock {
    /// As long as in the notifier's voice, if it has one; a step each with [`StepClock::Observation`].
    #[default]
    Voice,
    /// One step of the session each.
    Steps,
}

/// The form in which a client wants to read what is said.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SayForm {
    /// JSON, with names and words.
    #[default]
    Json,
    /// 24 bytes without text.
    Binary,
}

/// A client's question, as it is written.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct OpenRequest {
    protocol: u32,
    domain: String,
    obs_dim: Option<usize>,
    seconds_per_step: Option<f64>,
    #[serde(default)]
    clock: StepClock,
    stale_after: Option<f64>,
    lost_after: Option<f64>,
    seed: Option<u64>,
    words: Option<String>,
    #[serde(default)]
    word_clock: WordClock,
    person: Option<Value>,
    incarnation: Option<String>,
    #[serde(default)]
    encoding: SayForm,
}

/// What each key of a question has to be.
const RULES: [FieldRule; 13] = [
    FieldRule::required("protocol", "the version of the messages, 1", no_small_count),
    FieldRule::required("domain", "the name of the task, as a text", no_text),
    FieldRule::optional("obs_dim", "the number of an observation's numbers", |it| {
        or_null(it, no_count)
    }),
    FieldRule::optional("seconds_per_step", "a time in seconds", |it| or_null(it, no_number)),
    FieldRule::optional("clock", "timer, observation or word", |it| {
        no_choice(it, &["timer", "observation", "word"])
    }),
    FieldRule::optional("stale_after", "a time in seconds", |it| or_null(it, no_number)),
    FieldRule::optional("lost_after", "a time in seconds", |it| or_null(it, no_number)),
    FieldRule::optional("seed", "a whole number from 0", |it| or_null(it, no_count)),
    FieldRule::optional("words", "a text", |it| or_null(it, no_text)),
    FieldRule::optional("word_clock", "voice or steps", |it| no_choice(it, &["voice", "steps"])),
    FieldRule::optional("person", "anything", |_| None),
    FieldRule::optional("incarnation", "16 hexadecimal digits, as a text", |it| {
        or_null(it, no_text)
    }),
    FieldRule::optional("encoding", "json or binary", |it| no_choice(it, &["json", "binary"])),
];

/// What a session is to be, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionPlan {
    /// When steps are taken.
    pub clock: StepClock,
    /// How long a word takes.
    pub word_clock: WordClock,
    /// How long a step takes, in seconds.
    pub seconds_per_step: f64,
    /// The age from which on an observation is stale, in seconds.
    pub stale_after: f64,
    /// After which silence a client counts as lost, in seconds.
    pub lost_after: f64,
    /// Seed of every draw.
    pub seed: u64,
    /// The form of what is said.
    pub form: SayForm,
    /// Which start of the client asks; `None` from one that does not say.
    pub incarnation: Option<Incarnation>,
    /// Where observations come from.
    pub source: ObservationSource,
    /// What the client should know.
    pub notes: Vec<String>,
}

/// Why a session is refused.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum OpenRefusal {
    #[error("the question cannot be read: {0}")]
    Question(JsonFault),
    #[error("the answer cannot be written: {0}")]
    Answer(serde_json::Error),
    #[error("protocol {0} is asked for; this notifier speaks protocol {LIVE_PROTOCOL}")]
    Protocol(u32),
    #[error(
        "{WRONG_TASK}{served}, with {served_dim} numbers per observation; the client is of {}{}",
        quoted(.asked),
        asked_dim.map_or(String::new(), |n| format!(", with {n}"))
    )]
    Task { served: String, served_dim: usize, asked: String, asked_dim: Option<usize> },
    #[error("`{key}` is {given}; allowed: {allowed}")]
    Setting { key: &'static str, given: String, allowed: String },
    #[error("a client named `{0}` is here already; choose another name, or wait until it is gone")]
    Taken(String),
    #[error("no place is free: --max-sessions allows {}", counted(.0, "session"))]
    Full(usize),
    #[error("no place is free: the loudspeaker of --play speaks to one client")]
    OneLoudspeaker,
    #[error("the notifier has too much to do; ask again")]
    Busy,
    #[error("the session could not be opened: {0}")]
    Network(leadtime_link::Error),
}

// Clients get the sentence alone, so it contains its cause, and `source()` does not repeat it.
impl From<JsonFault> for OpenRefusal {
    fn from(fault: JsonFault) -> Self {
        Self::Question(fault)
    }
}

impl From<serde_json::Error> for OpenRefusal {
    fn from(error: serde_json::Error) -> Self {
        Self::Answer(error)
    }
}

impl From<leadtime_link::Error> for OpenRefusal {
    fn from(error: leadtime_link::Error) -> Self {
        Self::Network(error)
    }
}

impl SessionPlan {
    /// Reads a question and checks it against the policy; `seed` counts where the client names none.
    ///
    /// # Errors
    ///
    /// [`OpenRefusal`] if the question is no JSON of one, is for another task or protocol, or gives a key a value that
    /// is not allowed. The sentence is for the client.
    pub fn read(question: &[u8], policy: &WorkingPolicy, seed: u64) -> Result<Self, OpenRefusal> {
        let asked: OpenRequest = serde_json::from_slice(question)
            .map_err(|error| JsonFault::find(question, &RULES, &error))?;
        if asked.protocol != LIVE_PROTOCOL {
            return Err(OpenRefusal::Protocol(asked.protocol));
        }
        let served_dim = policy.obs_dim();
        let fits_dim = asked.obs_dim.is_none_or(|n| n == served_dim);
        if asked.domain != policy.domain || !fits_dim {
            let (served, asked_dim) = (policy.domain.clone(), asked.obs_dim);
            return Err(OpenRefusal::Task { served, served_dim, asked: asked.domain, asked_dim });
        }
        let patience = match asked.clock {
            StepClock::Observation => STEPPED_PATIENCE,
            StepClock::Timer | StepClock::Word => TIMED_PATIENCE,
        };
        let seconds_per_step = asked.seconds_per_step.unwrap_or(STEP);
        require("seconds_per_step", seconds_per_step, 1e-3, MAX_STEP)?;
        let stale_after = asked.stale_after.unwrap_or(patience.0.max(2.0 * seconds_per_step));
        require("stale_after", stale_after, 1e-3, MAX_PATIENCE)?;
        let lost_after =
            asked.lost_after.unwrap_or(patience.1.max(2.0 * stale_after).min(MAX_PATIENCE));
        require("lost_after", lost_after, stale_after, MAX_PATIENCE)?;
        let wrong = |key, given: &str, allowed: &str| OpenRefusal::Setting {
            key,
            given: quoted(given),
            allowed: allowed.to_owned(),
        };
        if let Some(words) = asked.words.filter(|words| words != "shipped") {
            return Err(wrong("words", &words, "shipped"));
        }
        let start = |text: &String| {
            let number = Incarnation::from_hex(text);
            number.ok_or_else(|| wrong("incarnation", text, "16 hexadecimal digits"))
        };
        let incarnation = asked.incarnation.as_ref().map(start).transpose()?;
        let mut notes = Vec::new();
        if asked.person.is_some() {
            let note = "`person` is not used: this policy does not observe its listener";
            notes.push(note.to_owned());
        }
        if policy.session.is_blind_to_repeats() {
            let note = "the policy was trained with a listener to whom it never repeats what they are already doing; \
                        a notifier at work cannot see what its listener does, so it may repeat itself";
            notes.push(note.to_owned());
        }
        Ok(Self {
            clock: asked.clock,
            word_clock: match asked.clock {
                // A simulator's time is its own: whatever the voice is, its decisions are the same.
                StepClock::Observation => WordClock::Steps,
                StepClock::Timer | StepClock::Word => asked.word_clock,
            },
            seconds_per_step,
            stale_after,
            lost_after,
            seed: asked.seed.unwrap_or(seed),
            form: asked.encoding,
            incarnation,
            source: ObservationSource::Client,
            notes,
        })
    }
}

fn require(key: &'static str, value: f64, low: f64, high: f64) -> Result<(), OpenRefusal> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    let (given, allowed) = (brief(value), format!("{low} to {high} seconds"));
    Err(OpenRefusal::Setting { key, given, allowed })
}

/// One number of an observation, for clients.
#[derive(Clone, Debug, Serialize)]
pub struct ObservationName {
    name: String,
    meaning: String,
    /// `None` where there is no bound.
    low: Option<f32>,
    high: Option<f32>,
}

impl From<&Quantity> for ObservationName {
    fn from(quantity: &Quantity) -> Self {
        let [low, high] = quantity.range.map(|bound| bound.is_finite().then_some(bound));
        Self { name: quantity.name.clone(), meaning: quantity.meaning.clone(), low, high }
    }
}

/// The policy of a session, for clients.
#[derive(Clone, Debug, Serialize)]
pub struct PolicyNote {
    /// SHA-256 over its file, in hexadecimal.
    pub sha256: String,
    /// Updates that made it; 0 where its file does not say.
    pub updates: u64,
}

/// What a recorder learns of a session: everything that is needed to open the same one again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionNote {
    /// Name of the client, as its keys have it.
    pub client: String,
    /// Name of the session, as the answer gave it.
    pub session: String,
    /// This start of the notifier, 16 hexadecimal digits.
    pub start: String,
    /// What the client asked for.
    pub question: Value,
    /// What it was answered.
    pub answer: Value,
    /// The policy, and how it was put to work.
    pub policy: PolicyOrigin,
    /// A checksum over the sentences.
    pub words_checksum: u32,
}

/// The voice of a notifier, for clients.
#[derive(Clone, Debug, Serialize)]
pub struct VoiceNote {
    /// Its name; of a helper and of a directory the kind alone.
    pub name: String,
    /// Samples per second; 0 where the notifier knows times without sound.
    pub rate: u32,
    /// Sentences that it has times for.
    pub sentences: usize,
    /// Those of them whose times were not measured.
    pub estimated: usize,
}

impl From<&VoiceBook> for VoiceNote {
    fn from(voice: &VoiceBook) -> Self {
        let (name, rate) = (told_voice(&voice.name).to_owned(), voice.rate);
        Self { name, rate, sentences: voice.sentences().count(), estimated: voice.n_estimated() }
    }
}

/// The answer to a client's question.
#[derive(Clone, Debug, Serialize)]
pub struct SessionAnswer<'a> {
    /// Name of the session, which its statuses and records repeat.
    pub session: &'a str,
    /// The notifier's start, as its token has it: once that is gone, so is the session.
    pub start: String,
    /// The version of the messages.
    pub protocol: u32,
    /// The task, by its domain.
    pub domain: &'a str,
    /// How many numbers an observation has.
    pub obs_dim: usize,
    /// Each of them; a client that takes 24 bytes per event gets no more than it has room for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub observation: Vec<ObservationName>,
    /// The topics, by number.
    pub topics: &'a [&'static str],
    /// The facts that an observation may state, with when each holds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub facts: Vec<Fact>,
    /// When steps are taken.
    pub clock: StepClock,
    /// How long a step takes.
    pub seconds_per_step: f64,
    /// The age from which on an observation is stale, in seconds.
    pub stale_after: f64,
    /// After which silence a client counts as lost, in seconds.
    pub lost_after: f64,
    /// Seed of every draw.
    pub seed: u64,
    /// The number that the next observation has to exceed; 0 for a new session.
    pub last_seq: u64,
    /// The policy that decides.
    pub policy: PolicyNote,
    /// How many sentences there are.
    pub sentences: usize,
    /// The settings of the task that the policy was made for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub task: Option<&'a Value>,
    /// Who speaks them; nothing where words come without times of their own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voice: Option<VoiceNote>,
    /// What the client should know.
    pub notes: &'a [String],
}

impl<'a> SessionAnswer<'a> {
    /// Puts the answer together.
    pub fn new(
        session: &'a str,
        start: Incarnation,
        plan: &'a SessionPlan,
        policy: &'a WorkingPolicy,
        last_seq: u64,
    ) -> Self {
        let is_whole = plan.form == SayForm::Json;
        let (observation, facts) =
            if is_whole { (policy.observation(), policy.facts()) } else { Default::default() };
        Self {
            session,
            start: start.hex(),
            protocol: LIVE_PROTOCOL,
            domain: &policy.domain,
            obs_dim: policy.obs_dim(),
            observation: observation.iter().map(ObservationName::from).collect(),
            topics: policy.session.topics(),
            facts: facts.to_vec(),
            clock: plan.clock,
            seconds_per_step: plan.seconds_per_step,
            stale_after: plan.stale_after,
            lost_after: plan.lost_after,
            seed: plan.seed,
            last_seq,
            policy: PolicyNote { sha256: policy.sha256.clone(), updates: policy.n_updates },
            sentences: policy.n_sentences(),
            task: policy.task.as_ref().filter(|_| is_whole),
            voice: policy.voice().as_deref().map(VoiceNote::from),
            notes: &plan.notes,
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// The longest answer to a client that takes 24 bytes per event, in bytes.
    const MAX_BRIEF: usize = 2_000;

    fn policy(domain: &str) -> WorkingPolicy {
        let words = leadtime_taxonomy::shipped(domain).unwrap();
        crate::test_support::policy(domain, Some(words))
    }

    #[test]
    fn every_field_of_a_question_has_a_rule() {
        let told = serde_json::from_str::<OpenRequest>(r#"{"?":1}"#).unwrap_err().to_string();
        let fields: Vec<&str> = told.split('`').skip(3).step_by(2).collect();
        assert_eq!(RULES.map(|rule| rule.name)[..], fields, "{told}");
        let question = br#"{"protocol":1,"domain":"lander","word_clock":"steps","clock":"tmer"}"#;
        let told = SessionPlan::read(question, &policy("lander"), 1).unwrap_err().to_string();
        assert!(
            told.ends_with("`clock` has to be timer, observation or word; it is \"tmer\""),
            "{told}"
        );
    }

    #[test]
    fn who_names_one_patience_is_not_refused_for_another_one() {
        let policy = policy("lander");
        let read = |key: &str, seconds: f64| {
            let question = json!({"protocol": 1, "domain": "lander", key: seconds});
            SessionPlan::read(question.to_string().as_bytes(), &policy, 1)
        };
        for (stale_after, lost_after) in [(0.1, 1.0), (2.0, 4.0), (400.0, 600.0), (600.0, 600.0)] {
            let plan = read("stale_after", stale_after).unwrap();
            assert_eq!((plan.stale_after, plan.lost_after), (stale_after, lost_after));
        }
        let told = read("stale_after", 601.0).unwrap_err().to_string();
        assert!(told.starts_with("`stale_after` is 601"), "{told}");
    }

    #[test]
    fn a_refusal_quotes_the_client_in_a_few_printable_words() {
        let policy = policy("lander");
        let told = |key: &str, value: Value| {
            let mut question = json!({"protocol": 1, "domain": "lander"});
            question[key] = value;
            let plan = SessionPlan::read(question.to_string().as_bytes(), &policy, 1);
            plan.unwrap_err().to_string()
        };
        let long = told("domain", format!("\u{1b}[31m{}", "x".repeat(60_000)).into());
        assert!(long.len() < 300 && !long.contains('\u{1b}'), "{long}");
        let signed = told("incarnation", "+00c0ffee00c0ffe".into());
        assert!(signed.contains("allowed: 16 hexadecimal digits"), "{signed}");
        let large = told("protocol", 4_294_967_296_u64.into());
        assert!(large.contains("`protocol` has to be the version of the messages, 1"), "{large}");
    }

    #[test]
    fn a_brief_answer_is_brief_and_names_no_command() {
        for domain in ["lander", "highway", "steakhouse"] {
            let origin =
                PolicyOrigin { voice: "pipe:say --key abc".to_owned(), ..Default::default() };
            let book = VoiceBook::new(format!("pipe:say --key {}", "a".repeat(2_000)), Vec::new());
            let policy = policy(domain).with_voice(Some(book)).put_to_work(origin);
            assert_eq!(policy.origin.voice, "pipe");
            let question =
                json!({"protocol": 1, "domain": domain, "encoding": "binary", "person": {}});
            let plan =
                SessionPlan::read(question.to_string().as_bytes(), &policy, u64::MAX).unwrap();
            let answer = SessionAnswer::new("0123abcd", Incarnation(1), &plan, &policy, u64::MAX);
            let answer = serde_json::to_string(&answer).unwrap();
            assert!(answer.len() < MAX_BRIEF, "{domain}: {} bytes", answer.len());
            assert!(answer.contains(r#""name":"pipe""#) && !answer.contains("--key"), "{answer}");
        }
        assert_eq!(told_voice("recorded:/home/me/words"), "recorded");
        assert_eq!(told_voice("flite:slt"), "flite:slt");
    }
}

//! Changes of single keys, as the command line gives them: `--set section.key=value`.

use std::fmt;

use leadtime_proto::text::quoted;
use toml::de::DeValue;
use toml::{Table, Value};

use crate::error::ConfigError;
use crate::nesting;

/// The most parts of a key.
const MAX_PARTS: usize = 16;

/// The option that changes a key, unless another one is named.
const SET: &str = "--set";
/// The sections, and the key, that are about training and not about the task.
const OF_TRAINING: [&str; 5] = ["actor", "learner", "policy", "run", "seed"];

/// One `--set section.key=value`.
#[derive(Clone, Debug)]
pub struct Override {
    /// The option that gave it, to be named in messages.
    pub(crate) option: &'static str,
    pub(crate) path: Vec<String>,
    pub(crate) value: Value,
}

impl Override {
    /// Makes a change of one key.
    pub fn new(key: &str, value: impl Into<Value>) -> Self {
        let path = key.split('.').map(str::to_owned).collect();
        Self { option: SET, path, value: value.into() }
    }

    /// Makes a change of each setting in a table.
    pub fn of_table(table: &Table) -> Vec<Self> {
        let mut changes = Vec::new();
        for (key, value) in table {
            let inner = match value {
                Value::Table(inner) => Self::of_table(inner),
                _ => vec![Self { option: SET, path: Vec::new(), value: value.clone() }],
            };
            changes.extend(inner.into_iter().map(|mut change| {
                change.path.insert(0, key.clone());
                change
            }));
        }
        changes
    }

    /// Refuses a setting of training, where a policy that is trained already is to act in a changed task.
    ///
    /// # Errors
    ///
    /// [`ConfigError`] with the key, if it is one of those, and the sections that are about the task.
    pub fn check_of_task(&self) -> Result<(), ConfigError> {
        if !self.path.first().is_some_and(|first| OF_TRAINING.contains(&first.as_str())) {
            return Ok(());
        }
        let (option, key) = (self.option, quoted(&self.key()));
        Err(ConfigError(format!(
            "{option}: `{key}` is a setting of training and changes nothing here; keys of the task are those of [world], \
             [human], [notifier] and [evaluation]"
        )))
    }

    /// Reads `section.key=value`; the value is TOML, or text if it is not TOML.
    ///
    /// # Errors
    ///
    /// If there is no `=` or no key in front of it, if the key has too many parts, if the value is nested too deeply, or
    /// if a whole number is beyond what TOML can hold.
    pub fn parse(text: &str) -> Result<Self, String> {
        let shown = quoted(text);
        let parts = text.split_once('=');
        let (key, value) =
            parts.ok_or_else(|| format!("`{shown}` is not of the form section.key=value"))?;
        let n_parts = key.split('.').count();
        if n_parts > MAX_PARTS {
            return Err(format!("the key has {n_parts} parts; allowed: at most {MAX_PARTS}"));
        }
        let path: Vec<String> = key.trim().split('.').map(str::to_owned).collect();
        if path.iter().any(String::is_empty) {
            return Err(format!("`{}` is not a key: write section.key=value", quoted(key)));
        }
        let value = value.trim();
        nesting::check_value(value).map_err(|error| format!("`{}` is {error}", quoted(key)))?;
        let value = match (value.parse(), DeValue::parse(value)) {
            (Ok(value), _) => value,
            (Err(_), Err(_)) => Value::String(value.to_owned()),
            (Err(_), Ok(read)) => {
                let whole = format!("whole numbers up to {}", i64::MAX);
                let allowed = match read.get_ref() {
                    DeValue::Integer(_) => whole,
                    DeValue::Float(_) => "numbers up to 1.8e308".to_owned(),
                    _ => format!("{whole}, and others up to 1.8e308"),
                };
                return Err(format!("`{}` is {}; allowed: {allowed}", quoted(key), quoted(value)));
            }
        };
        Ok(Self { option: SET, path, value })
    }

    /// Names another option that gave it.
    #[must_use]
    pub fn given_by(self, option: &'static str) -> Self {
        Self { option, ..self }
    }

    /// Returns the key as written: `learner.clip`.
    pub fn key(&self) -> String {
        self.path.join(".")
    }
}

/// The change as a line of TOML.
impl fmt::Display for Override {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let is_bare = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-';
        let quote = |part: &String| Value::from(part.as_str()).to_string();
        let shown =
            |part: &String| if part.bytes().all(is_bare) { part.clone() } else { quote(part) };
        let key: Vec<String> = self.path.iter().map(shown).collect();
        write!(f, "{} = {}", key.join("."), self.value)
    }
}

/// One `--each section.key=[values]`: a change per value.
#[derive(Clone, Debug)]
pub struct Alternatives(pub Vec<Override>);

impl Alternatives {
    /// Reads `section.key=[value, ...]`.
    ///
    /// # Errors
    ///
    /// As [`Override::parse`], and if the value is not a list, or an empty one.
    pub fn parse(text: &str) -> Result<Self, String> {
        let misshapen =
            || Err(format!("`{}` is not of the form section.key=[value, ...]", quoted(text)));
        if !text.contains('=') {
            return misshapen();
        }
        let Override { path, value, .. } = Override::parse(text)?;
        match value {
            Value::Array(values) if !values.is_empty() => {
                let change = |value| Override { option: "--each", path: path.clone(), value };
                Ok(Self(values.into_iter().map(change).collect()))
            }
            _ => misshapen(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_override_reads_toml_and_plain_words() {
        for (text, line) in [
            ("learner.clip=1", "learner.clip = 1"),
            ("learner.mode=sync", "learner.mode = \"sync\""),
            ("world.wind = true", "world.wind = true"),
            ("a.b c=x", "a.\"b c\" = \"x\""),
            ("a=1\nb=2", "a = \"\"\"\n1\nb=2\"\"\""),
        ] {
            assert_eq!(Override::parse(text).unwrap().to_string(), line);
        }
        for text in ["clip", ".clip=1", "learner..clip=1", "seed=9223372036854775808"] {
            assert!(Override::parse(text).is_err(), "{text}");
        }
        let allowed = |text: &str| {
            let told = Override::parse(text).unwrap_err();
            told.split_once("allowed: ").unwrap().1.to_owned()
        };
        assert_eq!(allowed("learner.clip=1e400"), "numbers up to 1.8e308");
        assert_eq!(allowed("seed=9223372036854775808"), "whole numbers up to 9223372036854775807");
        let both = "whole numbers up to 9223372036854775807, and others up to 1.8e308";
        assert_eq!(allowed("policy.hidden=[1e400]"), both);
    }

    #[test]
    fn an_override_that_is_too_deep_or_too_long_is_refused_in_one_line() {
        let error = Override::parse(&format!("{}=1", vec!["a"; 60_000].join("."))).unwrap_err();
        assert_eq!(error, "the key has 60000 parts; allowed: at most 16");
        let deep = format!("a={}{}", "[".repeat(40), "]".repeat(40));
        let error = Override::parse(&deep).unwrap_err();
        assert_eq!(error, "`a` is nested too deeply; allowed: at most 32 levels");
        let error = Override::parse(&"a".repeat(1_000_000)).unwrap_err();
        assert!(error.len() < 250, "{error}");
    }

    #[test]
    fn alternatives_are_an_override_each() {
        let each = Alternatives::parse("human.delay=[{fixed=0}, {fixed=2}]").unwrap();
        let texts: Vec<String> = each.0.iter().map(ToString::to_string).collect();
        assert_eq!(texts, ["human.delay = { fixed = 0 }", "human.delay = { fixed = 2 }"]);
        assert!(each.0.iter().all(|change| change.option == "--each"));
        for text in ["human.delay=3", "human.delay=[]", "human.delay"] {
            let told = format!("`{text}` is not of the form section.key=[value, ...]");
            assert_eq!(Alternatives::parse(text).unwrap_err(), told);
        }
    }

    #[test]
    fn a_table_is_a_change_of_each_of_its_settings_and_those_of_training_are_told_apart() {
        let table: Table = "learner.clip = 0.1\n[human]\nreaction_delay.fixed = 2".parse().unwrap();
        let [human, learner] = &Override::of_table(&table)[..] else { panic!("two changes") };
        assert_eq!(human.to_string(), "human.reaction_delay.fixed = 2");
        human.check_of_task().unwrap();
        let told = learner.check_of_task().unwrap_err().to_string();
        assert!(told.starts_with("--set: `learner.clip` is a setting of training"), "{told}");
    }
}

//! A script as data: an ordered list of rules, written and read as TOML.
//!
//! ```toml
//! [[rules]]
//! say = { topic = "ascend", k = 2, l = 2 }
//! pause = 3
//! when = [{ of = "y", ahead = 0.5, below = 0.4 }, { of = "x", above = -0.2 }]
//! ```
//!
//! Whenever the listener would hear a message, the first rule whose conditions all hold decides. A rule without `say` keeps
//! silent. After its message has started, `pause` steps pass before a rule is asked again.

use std::fmt;

use serde::{Deserialize, Serialize};

use leadtime_proto::wording::worded;

use crate::error::Error;

/// The most rules of a script, and conditions of a rule.
const MOST: usize = 64;
/// The longest look ahead, in steps, and the longest pause.
const LONGEST: f64 = 1000.0;
/// A bound nearer to zero than this is written with an exponent.
const TINY: f64 = 1e-6;

/// An ordered list of rules; the first that holds decides.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Script {
    /// The rules, in the order in which they are asked.
    pub rules: Vec<ScriptRule>,
}

/// What is said when some conditions hold.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScriptRule {
    /// The message; none: silence, and later rules are not asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub say: Option<ScriptMessage>,
    /// Steps after the message's start in which no rule is asked. Default 0.
    #[serde(default)]
    pub pause: u32,
    /// All of them must hold; none: the rule always holds.
    #[serde(default)]
    pub when: Vec<ScriptCondition>,
}

/// A message by the name of its topic.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScriptMessage {
    /// The topic, by its name.
    pub topic: String,
    /// Comprehension time, in words.
    pub k: u32,
    /// Conveyance time, in words; at least k.
    pub l: u32,
}

/// Bounds for a number that the task shows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScriptCondition {
    /// The number's name, as `leadtime describe` has it for one step.
    pub of: String,
    /// Looks so many steps ahead: its last change, times this, is added. Only for numbers of the observation, where the
    /// notifier's history is longer than 1. Default 0.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub ahead: f64,
    /// It must be at least this.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub above: Option<f64>,
    /// It must be less than this.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub below: Option<f64>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands out references")]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl Script {
    /// Reads a script; other sections of the text are its author's.
    ///
    /// # Errors
    ///
    /// [`Error::Text`] if the text is no script in TOML, [`Error::TooLong`] and [`Error::Rule`] as [`Script::check`].
    pub fn read(text: &str) -> Result<Self, Error> {
        /// A file, of which a script needs the rules only.
        #[derive(Deserialize)]
        struct ScriptFile {
            rules: Vec<ScriptRule>,
        }
        let refused = |error: toml::de::Error| {
            let at = error.span().map_or(0, |span| span.start);
            let line = 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
            Error::Text { line, reason: worded(error.message()).replace('\n', ", ") }
        };
        let ScriptFile { rules } = toml::from_str(text).map_err(refused)?;
        let script = Self { rules };
        script.check()?;
        Ok(script)
    }

    /// Checks lengths and numbers.
    ///
    /// # Errors
    ///
    /// [`Error::TooLong`] if there are more than 64 rules, [`Error::Rule`] if a number is out of its range.
    pub fn check(&self) -> Result<(), Error> {
        let n = self.rules.len();
        if n > MOST {
            return Err(Error::TooLong { n, most: MOST });
        }
        let check = |(i, rule): (usize, &ScriptRule)| {
            let refused = |sentence| Error::Rule { rule: i + 1, sentence };
            rule.check().map_err(refused)
        };
        self.rules.iter().enumerate().try_for_each(check)
    }

    /// Lists what is possible and hardly meant: rules that never hold, and rules that are never asked.
    pub fn oddities(&self) -> Vec<String> {
        let mut found = Vec::new();
        for (i, rule) in self.rules.iter().enumerate() {
            let n = i + 1;
            for ScriptCondition { of, above, below, .. } in &rule.when {
                match (above, below) {
                    (Some(above), Some(below)) if above >= below => found.push(format!(
                        "rule {n} never holds: no {of} is at least {above} and below {below}"
                    )),
                    (None, None) => found.push(format!(
                        "rule {n}: its condition on {of} has neither `above` nor `below`, and always holds"
                    )),
                    _ => {}
                }
            }
            let is_free = |it: &ScriptCondition| it.above.is_none() && it.below.is_none();
            if rule.when.iter().all(is_free) && n < self.rules.len() {
                found.push(format!("no rule after rule {n} is ever asked: it always holds"));
                break;
            }
        }
        found
    }

    /// Writes the rules as TOML.
    pub fn toml(&self) -> String {
        // Plain data of one table can always be written.
        toml::to_string(self).unwrap_or_default()
    }

    /// Writes a file: the rules, and `section`, in which its author says where they are from.
    pub fn file(&self, section: &str) -> String {
        let rules = self.toml();
        // Without rules their key must stand before the section: after it, the key would be one of the section's.
        if self.rules.is_empty() {
            format!("{rules}\n{section}")
        } else {
            format!("{section}\n{rules}")
        }
    }
}

impl ScriptRule {
    fn check(&self) -> Result<(), String> {
        if self.when.len() > MOST {
            return Err(format!("{} conditions; allowed: at most {MOST}", self.when.len()));
        }
        if f64::from(self.pause) > LONGEST {
            return Err(format!("`pause` is {}; allowed: at most {LONGEST} steps", self.pause));
        }
        if let Some(ScriptMessage { k, l, .. }) = self.say
            && k > l
        {
            return Err(format!("`k` is {k} and `l` is {l}; allowed: k up to l"));
        }
        for ScriptCondition { of, ahead, above, below } in &self.when {
            if !(0.0..=LONGEST).contains(ahead) {
                return Err(format!("`ahead` of {of} is {ahead}; allowed: 0 to {LONGEST} steps"));
            }
            if [above, below].into_iter().flatten().any(|bound| !bound.is_finite()) {
                return Err(format!("a bound of {of} is not finite"));
            }
        }
        Ok(())
    }
}

/// Writes a rule a line, in words.
impl fmt::Display for Script {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, rule) in self.rules.iter().enumerate() {
            if i > 0 {
                f.write_str("\n")?;
            }
            write!(f, "{}. {rule}", i + 1)?;
        }
        Ok(())
    }
}

impl fmt::Display for ScriptRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.say {
            Some(ScriptMessage { topic, k, l }) => write!(f, "say {topic} (k {k}, l {l})")?,
            None => f.write_str("keep silent")?,
        }
        for (i, condition) in self.when.iter().enumerate() {
            write!(f, " {} {condition}", if i == 0 { "if" } else { "and" })?;
        }
        if self.say.is_some() && self.pause > 0 {
            write!(f, "; then pause {} steps", self.pause)?;
        }
        Ok(())
    }
}

impl fmt::Display for ScriptCondition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { of, ahead, above, below } = self;
        if let Some(above) = above {
            write!(f, "{} <= ", bound(*above))?;
        }
        f.write_str(of)?;
        if *ahead > 0.0 {
            write!(f, " in {ahead} steps")?;
        }
        match below {
            Some(below) => write!(f, " < {}", bound(*below)),
            None => Ok(()),
        }
    }
}

/// Writes a bound in words: one that is nearly zero without a row of zeros. The file has all its digits.
fn bound(value: f64) -> String {
    let is_tiny = value != 0.0 && value.abs() < TINY;
    if is_tiny { format!("{value:.1e}") } else { value.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"
[[rules]]
say = { topic = "ascend", k = 2, l = 3 }
pause = 4
when = [{ of = "y", ahead = 0.5, below = 0.4 }, { of = "x", above = -0.2, below = 0.1 }]

[[rules]]
when = [{ of = "y", above = 1.1 }]

[[rules]]
say = { topic = "descend", k = 2, l = 2 }
"#;

    #[test]
    fn a_bound_that_is_nearly_zero_is_short_and_others_are_as_they_were() {
        let shown = [-0.000_000_000_000_000_162, 2.5e-7, 0.0, -0.2, 0.000_3, 12.0].map(bound);
        assert_eq!(shown, ["-1.6e-16", "2.5e-7", "0", "-0.2", "0.0003", "12"]);
    }

    #[test]
    fn a_script_is_read_written_and_put_into_words() {
        let script = Script::read(TEXT).unwrap();
        assert_eq!(Script::read(&script.toml()).unwrap(), script);
        let silent = Script::default();
        for script in [&script, &silent] {
            let searched = script.file("[search]\nseed = 1\n");
            assert_eq!(Script::read(&searched).unwrap(), *script, "{searched}");
            let section = searched.parse::<toml::Table>().unwrap();
            assert_eq!(section["search"].as_table().unwrap().len(), 1, "{searched}");
        }
        let words = "1. say ascend (k 2, l 3) if y in 0.5 steps < 0.4 and -0.2 <= x < 0.1; then pause 4 steps\n\
                     2. keep silent if 1.1 <= y\n\
                     3. say descend (k 2, l 2)";
        assert_eq!(script.to_string(), words);
    }

    #[test]
    fn rules_that_are_hardly_meant_are_listed() {
        assert_eq!(Script::read(TEXT).unwrap().oddities(), [] as [&str; 0]);
        let text = "rules = [{ when = [{ of = \"y\", above = 1.0, below = 0.5 }] }, { when = [{ of = \"x\" }] }, { pause = 1 }]";
        let says = [
            "rule 1 never holds: no y is at least 1 and below 0.5",
            "rule 2: its condition on x has neither `above` nor `below`, and always holds",
            "no rule after rule 2 is ever asked: it always holds",
        ];
        assert_eq!(Script::read(text).unwrap().oddities(), says);
    }

    #[test]
    fn what_is_wrong_with_a_rule_is_told() {
        let refused =
            |rule: &str| Script::read(&format!("[[rules]]\n{rule}")).unwrap_err().to_string();
        assert_eq!(
            refused("say = { topic = \"up\", k = 3, l = 2 }"),
            "rule 1: `k` is 3 and `l` is 2; allowed: k up to l"
        );
        assert!(
            refused("when = [{ of = \"y\", ahead = -1.0 }]").contains("allowed: 0 to 1000 steps")
        );
        assert!(refused("when = [{ of = \"y\", below = inf }]").contains("not finite"));
        assert!(refused("pause = 1001").contains("allowed: at most 1000 steps"));
        assert!(
            refused("\nwen = []").starts_with("line 3 of the script: unknown key `wen`; did you")
        );
        let negative =
            "line 2 of the script: invalid value: whole number `-1`, expected a whole number that";
        assert!(refused("pause = -1").starts_with(negative));
        let long = "[[rules]]\n".repeat(65);
        assert!(Script::read(&long).unwrap_err().to_string().contains("at most 64"));
    }
}

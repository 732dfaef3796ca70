//! What a sentence must be before anybody is asked to rate it.

use std::collections::BTreeSet;

use super::candidate::Reason;
use super::plan::DatabasePlan;
use super::structure::{Lexicon, Structure};
use crate::words;

/// Words that turn an instruction into its opposite.
const NEGATIONS: [&str; 6] = ["not", "don't", "never", "cannot", "can't", "won't"];

/// Words that nobody should hear from a machine.
const RUDE: [&str; 10] =
    ["idiot", "stupid", "moron", "damn", "damned", "hell", "crap", "fool", "dumb", "fucking"];

#[derive(Clone, Debug)]
pub(super) struct Rules {
    lexicon: Lexicon,
    words: [u32; 2],
    rejected: BTreeSet<String>,
}

impl Rules {
    /// Collects a plan's rules.
    pub(super) fn new(plan: &DatabasePlan) -> Self {
        Self {
            lexicon: Lexicon::new(plan),
            words: plan.words,
            rejected: plan.reject.iter().map(|text| words::normalised(text)).collect(),
        }
    }

    /// Checks a sentence that was proposed for a topic, and takes it apart; or gives the first reason to turn it down.
    pub(super) fn check(&self, text: &str, topic: usize) -> Result<Structure, Reason> {
        check_characters(text)?;
        let words = words::words(text);
        let [from, to] = self.words;
        let has = |list: &[&str]| words.iter().any(|word| list.contains(&word.as_str()));
        refuse_if(words.is_empty(), Reason::Empty)?;
        refuse_if(!(from..=to).contains(&(words.len() as u32)), Reason::WordCount)?;
        refuse_if(has(&NEGATIONS), Reason::Negation)?;
        refuse_if(has(&RUDE), Reason::Profanity)?;
        refuse_if(words.windows(2).any(|pair| pair[0] == pair[1]), Reason::Repetition)?;
        let structure = self.lexicon.analyse(&words)?;
        refuse_if(structure.topic != topic, Reason::WrongAction)?;
        refuse_if(self.rejected.contains(&words.join(" ")), Reason::HumanReject)?;
        Ok(structure)
    }
}

fn check_characters(text: &str) -> Result<(), Reason> {
    refuse_if(text.contains('?'), Reason::Question)?;
    refuse_if(text.chars().any(|c| c.is_ascii_digit()), Reason::Digit)?;
    let fits = |c: char| c.is_ascii_alphabetic() || " '-,.!;:".contains(c);
    refuse_if(!text.chars().all(fits), Reason::Charset)
}

fn refuse_if(broken: bool, reason: Reason) -> Result<(), Reason> {
    if broken { Err(reason) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::job;

    #[test]
    fn every_rule_turns_down_what_it_should() {
        let mut plan = job::plan("lander").unwrap();
        plan.reject = vec!["Pull up hard".to_owned()];
        let rules = Rules::new(&plan);
        let ascend = plan.topic_idx("ascend").unwrap();
        let cases = [
            ("Go up?", Reason::Question),
            ("Go up 20 meters.", Reason::Digit),
            ("Go up \u{2013} now.", Reason::Charset),
            (" ... ", Reason::Empty),
            ("Ascend.", Reason::WordCount),
            ("Go up to avoid the zone.", Reason::WordCount),
            ("Don't go up.", Reason::Negation),
            ("Go up, idiot.", Reason::Profanity),
            ("Go up, up now.", Reason::Repetition),
            ("Zone ahead, careful.", Reason::NoDirective),
            ("Go up, shift left.", Reason::TwoDirectives),
            ("Shift left.", Reason::WrongAction),
            ("pull up, hard!", Reason::HumanReject),
        ];
        for (text, reason) in cases {
            assert_eq!(rules.check(text, ascend), Err(reason), "{text}");
        }
        rules.check("Avoid top-left danger zone, ascend.", ascend).unwrap();
    }
}

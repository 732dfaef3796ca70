//! A script bound to a task: names have become places, so that a step costs little.

use std::error::Error as StdError;

use leadtime_episodes::{EnvSlot, Scripted};
use leadtime_proto::phrase::no_such;
use leadtime_sims::{Environment, Message, Scriptable};

use crate::error::Error;
use crate::script::{Script, ScriptCondition, ScriptRule};

/// A script whose names have been found in a task.
#[derive(Clone, Debug)]
pub struct BoundScript {
    rules: Vec<BoundRule>,
    /// The task's numbers now, and a step ago.
    now: Vec<f32>,
    before: Vec<f32>,
}

#[derive(Clone, Debug)]
struct BoundRule {
    say: Option<Message>,
    pause: u32,
    when: Vec<BoundCondition>,
}

#[derive(Clone, Copy, Debug)]
struct BoundCondition {
    place: usize,
    ahead: f64,
    above: f64,
    below: f64,
}

impl BoundScript {
    /// Finds the numbers and messages of a script in a task.
    ///
    /// # Errors
    ///
    /// [`Error::NoMessages`] if none are sent in it; [`Error::Rule`] if a rule names a number, or says a message, that the
    /// task does not have, or looks ahead at a number whose last change is not known.
    pub fn bind(script: &Script, environment: &dyn Environment) -> Result<Self, Error> {
        let task = environment.scriptable().ok_or(Error::NoMessages)?;
        script.check()?;
        let names: Vec<String> = task.quantities().into_iter().map(|it| it.name).collect();
        let messages = task.messages();
        let bind = |(i, rule): (usize, &ScriptRule)| {
            let bound = bind_rule(rule, task, &names, &messages);
            bound.map_err(|sentence| Error::Rule { rule: i + 1, sentence })
        };
        let rules = script.rules.iter().enumerate().map(bind).collect::<Result<_, _>>()?;
        let n = names.len();
        Ok(Self { rules, now: vec![0.0; n], before: vec![0.0; n] })
    }

    /// Decides in a step, and writes the action; `quiet` holds the steps that are left of a pause.
    ///
    /// An environment without messages gets silence.
    pub fn act(&mut self, environment: &dyn Environment, quiet: &mut f32, action: &mut [u8]) {
        let said = self.decide(environment, quiet);
        match environment.scriptable() {
            Some(task) => task.write_action(said, action),
            None => action.fill(0),
        }
    }

    fn decide(&mut self, environment: &dyn Environment, quiet: &mut f32) -> Option<Message> {
        if *quiet > 0.0 {
            *quiet -= 1.0;
            return None;
        }
        let task = environment.scriptable().filter(|task| task.may_start())?;
        task.write_quantities(&mut self.now, &mut self.before);
        let (now, before) = (&self.now, &self.before);
        let holds = |rule: &&BoundRule| rule.when.iter().all(|it| it.holds(now, before));
        let rule = self.rules.iter().find(holds)?;
        if rule.say.is_some() {
            *quiet = rule.pause as f32;
        }
        rule.say
    }
}

fn bind_rule(
    rule: &ScriptRule,
    task: &dyn Scriptable,
    names: &[String],
    messages: &[Message],
) -> Result<BoundRule, String> {
    let topics = task.topics();
    let place = |of: &String| {
        let found = names.iter().position(|name| name == of);
        found.ok_or_else(|| no_such("number", of, names.iter().map(String::as_str)))
    };
    let condition = |it: &ScriptCondition| {
        let (above, below) =
            (it.above.unwrap_or(f64::NEG_INFINITY), it.below.unwrap_or(f64::INFINITY));
        let place = place(&it.of)?;
        check_ahead(it, place, task)?;
        Ok(BoundCondition { place, ahead: it.ahead, above, below })
    };
    let when = rule.when.iter().map(condition).collect::<Result<_, String>>()?;
    let say = rule.say.as_ref().map(|said| {
        let topic = topics.iter().position(|name| *name == said.topic);
        let topic = topic.ok_or_else(|| no_such("topic", &said.topic, topics.iter().copied()))?;
        let message = Message { topic, comprehension: said.k, conveyance: said.l };
        let lengths = || messages.iter().filter(|it| it.topic == topic);
        if lengths().any(|it| *it == message) {
            return Ok(message);
        }
        let known: Vec<String> =
            lengths().map(|it| format!("({}, {})", it.comprehension, it.conveyance)).collect();
        let (k, l) = (said.k, said.l);
        Err(format!(
            "{} cannot be said with (k, l) = ({k}, {l}); known: {}",
            said.topic,
            known.join(", ")
        ))
    });
    Ok(BoundRule { say: say.transpose()?, pause: rule.pause, when })
}

/// Refuses to look ahead at a number of which nothing is remembered: its last change would count as 0 without a word.
fn check_ahead(
    condition: &ScriptCondition,
    place: usize,
    task: &dyn Scriptable,
) -> Result<(), String> {
    let ScriptCondition { of, ahead, .. } = condition;
    if *ahead <= 0.0 || place < task.n_remembered() {
        return Ok(());
    }
    let why = if place < task.n_observed() {
        "with `notifier.history = 1` no number is remembered for a step"
    } else {
        "only numbers of the observation are remembered for a step"
    };
    Err(format!("`ahead` of {of} is {ahead}, and {why}; allowed: 0"))
}

impl BoundCondition {
    fn holds(&self, now: &[f32], before: &[f32]) -> bool {
        let (now, before) = (f64::from(now[self.place]), f64::from(before[self.place]));
        let value = now + self.ahead * (now - before);
        self.above <= value && value < self.below
    }
}

/// Plays a script in one episode after the other.
#[derive(Clone, Debug)]
pub struct ScriptPlayer {
    script: Script,
    /// Bound in the first step.
    bound: Option<BoundScript>,
}

impl ScriptPlayer {
    /// Makes a player of a script; whether it fits a task is checked there.
    pub fn new(script: Script) -> Self {
        Self { script, bound: None }
    }
}

impl Scripted for ScriptPlayer {
    fn check(&self, environment: &dyn Environment) -> Result<(), Box<dyn StdError + Send + Sync>> {
        BoundScript::bind(&self.script, environment)?;
        Ok(())
    }

    fn memory_dim(&self) -> usize {
        1
    }

    fn choose(&mut self, slot: &mut EnvSlot, choices: &mut [u8]) {
        choices.fill(0);
        if self.bound.is_none() {
            self.bound = BoundScript::bind(&self.script, slot.env()).ok();
        }
        let mut quiet = slot.memory().first().copied().unwrap_or_default();
        if let Some(bound) = &mut self.bound {
            bound.act(slot.env(), &mut quiet, choices);
        }
        slot.memory().fill(quiet);
    }

    fn copy(&self) -> Box<dyn Scripted> {
        Box::new(Self { bound: None, ..self.clone() })
    }
}

#[cfg(test)]
mod tests {
    use leadtime_episodes::Player;
    use leadtime_sims::classic::{CartPole, CartPoleSettings};
    use leadtime_sims::notifier::NotifierSettings;

    use super::*;
    use crate::test_support::{cliff, cliff_with, played, share};

    fn refused(rules: &str) -> String {
        let script = Script::read(rules).unwrap();
        BoundScript::bind(&script, cliff().unwrap().as_ref()).unwrap_err().to_string()
    }

    fn player(rules: &str) -> Player {
        Player::scripted("script", Box::new(ScriptPlayer::new(Script::read(rules).unwrap())))
    }

    #[test]
    fn names_that_a_task_does_not_have_are_refused() {
        let error = refused("[[rules]]\nwhen = [{ of = \"lift\", below = 1.0 }]");
        assert_eq!(
            error,
            "rule 1: there is no number `lift`; did you mean `left`? Known: walked, left, step"
        );
        let error = refused("[[rules]]\n[[rules]]\nsay = { topic = \"dance\", k = 2, l = 2 }");
        assert_eq!(error, "rule 2: there is no topic `dance`. Known: stop, sing");
        let error = refused("[[rules]]\nsay = { topic = \"stop\", k = 1, l = 2 }");
        assert!(
            error.contains("stop cannot be said with (k, l) = (1, 2); known: (2, 2), (2, 3)"),
            "{error}"
        );
        let cartpole = CartPole::new(&CartPoleSettings::default()).unwrap();
        let error = BoundScript::bind(&Script::default(), &cartpole).unwrap_err();
        assert!(error.to_string().contains("no messages are sent"), "{error}");
    }

    #[test]
    fn the_first_rule_that_holds_decides_and_a_pause_is_kept() {
        let always = "[[rules]]\nsay = { topic = \"sing\", k = 2, l = 2 }";
        let n_said =
            |rules: &str| played(&player(rules), 20, 3).iter().map(|it| it[2]).sum::<f64>();
        let without = n_said(always);
        let with = n_said(&format!("{always}\npause = 30"));
        assert!(without > 5.0 * 20.0 && with == 20.0, "{without} {with}");
        assert_eq!(n_said(&format!("[[rules]]\n{always}")), 0.0, "silence comes first");
        let far = "[[rules]]\nwhen = [{ of = \"left\", above = 6.5 }]\n";
        let stop = "[[rules]]\nsay = { topic = \"stop\", k = 2, l = 2 }";
        assert_eq!(share(&played(&player(&format!("{far}{stop}")), 50, 3)), 1.0);
        assert_eq!(share(&played(&player(stop), 50, 3)), 0.0, "too early");
    }

    #[test]
    fn looking_ahead_adds_the_last_change() {
        let stop_at = |when: &str| {
            let say = "say = { topic = \"stop\", k = 2, l = 2 }";
            played(&player(&format!("[[rules]]\n{say}\nwhen = [{{ {when} }}]")), 20, 3)
        };
        // It walks one step a step: four steps before.
        let ahead = stop_at("of = \"walked\", ahead = 4.0, above = 9.0");
        assert_eq!(ahead, stop_at("of = \"walked\", above = 5.0"));
        assert_ne!(ahead, stop_at("of = \"walked\", above = 6.0"));
    }

    #[test]
    fn no_rule_looks_ahead_at_a_number_that_is_not_remembered() {
        let bound = |of: &str, history| {
            let rule = format!("[[rules]]\nwhen = [{{ of = \"{of}\", ahead = 2.0, below = 4.0 }}]");
            let settings = NotifierSettings { history, ..NotifierSettings::default() };
            let environment = cliff_with(&settings).unwrap();
            let bound = BoundScript::bind(&Script::read(&rule).unwrap(), environment.as_ref());
            bound.map_err(|error| error.to_string())
        };
        bound("walked", 2).unwrap();
        let added = "only numbers of the observation are remembered for a step; allowed: 0";
        let short = "with `notifier.history = 1` no number is remembered for a step; allowed: 0";
        let refused =
            [("left", 2, added), ("step", 2, added), ("left", 1, added), ("walked", 1, short)];
        for (of, history, why) in refused {
            let says = format!("rule 1: `ahead` of {of} is 2, and {why}");
            assert_eq!(bound(of, history).unwrap_err(), says);
        }
    }
}

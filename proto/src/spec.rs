//! What an environment asks for and what a policy is: shapes, factored action heads, masks.
//!
//! An action is a tuple with one choice per **head**; for a notifier (initiate, topic, k, l). The heads are sampled
//! in order. Three rules shape the joint distribution, and actor and learner apply the same three:
//!
//! * the environment's **mask** of this step removes choices (a message may not start now);
//! * a [`Conditional`] removes choices of one head given an earlier head's choice (l >= k);
//! * a [`Gate`] says when the other heads matter at all (only when a message starts); with
//!   [`HeadCredit::Active`] heads behind a closed gate add nothing to log-probability and entropy.

mod action;
mod error;
mod policy;
mod run;

pub use action::{ActionSpec, COMPUTED, Conditional, EnvSpec, Gate, Head, Mask};
pub use error::SpecError;
pub use policy::{EgoAttention, Encoder, HeadCredit, PolicySpec};
pub use run::{RunSpec, TaskSpec};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Schedule;

    fn notifier() -> ActionSpec {
        let head = |name: &str, n_choices| Head { name: name.to_owned(), n_choices };
        let allowed = vec![0b1111, 0b1110, 0b1100, 0b1000];
        ActionSpec {
            heads: vec![head("initiate", 2), head("topic", 4), head("k", 4), head("l", 4)],
            gate: Some(Gate { head: 0, choice: 1 }),
            conditionals: vec![Conditional { head: 3, given: 2, allowed }],
        }
    }

    #[test]
    fn a_message_is_never_shorter_than_its_comprehension() {
        let spec = notifier();
        spec.check().unwrap();
        assert!(spec.allows(Mask::ALL, &[1, 0, 2, 2]));
        assert!(!spec.allows(Mask::ALL, &[1, 0, 2, 1]));
        // A mask removes choices, too.
        let silent = Mask(!0b10);
        assert!(!spec.allows(silent, &[1, 0, 0, 0]) && spec.allows(silent, &[0, 0, 0, 0]));
    }

    #[test]
    fn attention_fits_its_observation() {
        let attention = EgoAttention {
            n_frames: 4,
            n_entities: 10,
            n_features: 7,
            action_dim: 13,
            width: 64,
            n_heads: 2,
        };
        // Four frames of 10 x 7 numbers and an action of 13, then the utterance's status of 5.
        attention.check(337).unwrap();
        assert_eq!(attention.feature_dim(337), 4 * (64 + 13) + 5);
        assert_eq!(
            attention.check(331),
            Err(SpecError::Attention { encoder: format!("{attention:?}"), obs_dim: 331 })
        );
        EgoAttention { n_heads: 3, ..attention }.check(337).unwrap_err();
        EgoAttention { n_frames: usize::MAX, ..attention }.check(337).unwrap_err();
    }

    #[test]
    fn impossible_action_spaces_are_named() {
        let mut spec = notifier();
        spec.conditionals[0].allowed[3] = 0;
        assert_eq!(spec.check(), Err(SpecError::Conditional { head: 3, given: 2 }));
        let mut spec = notifier();
        spec.heads[3].name = "topic".to_owned();
        assert_eq!(spec.check(), Err(SpecError::SameHead("topic".to_owned())));
        let mut spec = notifier();
        spec.gate = Some(Gate { head: 1, choice: 0 });
        assert_eq!(spec.check(), Err(SpecError::Gate { head: 1, choice: 0 }));
        assert_eq!(ActionSpec::discrete("a", 65).check(), Err(SpecError::TotalChoices(65)));
    }

    #[test]
    fn metrics_that_no_report_could_tell_apart_are_named() {
        let check = |names: &[&str]| {
            let metrics = names.iter().map(|&name| name.to_owned()).collect();
            EnvSpec { obs_dim: 4, actions: notifier(), metrics }.check()
        };
        check(&["success", "fuel"]).unwrap();
        let twice = check(&["success", "fuel", "success"]);
        assert_eq!(twice, Err(SpecError::SameMetric("success".to_owned())));
        let computed = check(&["success", "return"]);
        assert_eq!(computed, Err(SpecError::ComputedMetric("return".to_owned())));
    }

    #[test]
    fn a_policy_for_another_environment_is_refused() {
        let env = EnvSpec { obs_dim: 4, actions: notifier(), metrics: Vec::new() };
        let run = RunSpec {
            seed: 1,
            task: TaskSpec { domain: "cartpole".to_owned(), settings: "{}".to_owned() },
            policy: PolicySpec::dense(&env, &[8]),
            env,
            n_steps: 8,
            schedule: Schedule::Lag(0),
        };
        run.check().unwrap();
        let spoilt = |spoil: fn(&mut RunSpec)| {
            let mut run = run.clone();
            spoil(&mut run);
            run.check().unwrap_err()
        };
        assert_eq!(spoilt(|run| run.policy.obs_dim = 5), SpecError::Policy);
        assert_eq!(spoilt(|run| run.env.actions.gate = None), SpecError::Policy);
        assert_eq!(spoilt(|run| run.n_steps = 0), SpecError::Steps(0));
        let nine = |run: &mut RunSpec| {
            run.policy.actions.heads = vec![run.policy.actions.heads[0].clone(); 9];
        };
        assert_eq!(spoilt(nine), SpecError::Heads { n_heads: 9 });
    }
}

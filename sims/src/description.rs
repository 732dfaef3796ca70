//! What the numbers of an observation, the choices of an action and the parts of a reward mean: for people, pages and policy
//! files. No policy sees any of it.

use leadtime_proto::EnvSpec;
use serde::Serialize;

/// One number of an observation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Quantity {
    /// Its name, unique within its part of the observation: `x`, `car2.vx`.
    pub name: String,
    /// What it is, with its unit.
    pub meaning: String,
    /// Its least and greatest value; infinite where there is no bound.
    pub range: [f32; 2],
}

impl Quantity {
    /// Describes a number with a range.
    pub fn new(name: impl Into<String>, meaning: impl Into<String>, range: [f32; 2]) -> Self {
        Self { name: name.into(), meaning: meaning.into(), range }
    }

    /// Describes a number that is 0 or 1.
    pub fn flag(name: impl Into<String>, meaning: impl Into<String>) -> Self {
        Self::new(name, meaning, [0.0, 1.0])
    }

    /// Describes the numbers of a task that does not say what they are: `observation0`, `observation1`, ...
    pub fn unnamed(n: usize) -> Vec<Self> {
        let unbounded = [f32::NEG_INFINITY, f32::INFINITY];
        (0..n).map(|i| Self::new(format!("observation{i}"), "", unbounded)).collect()
    }
}

/// What an observation consists of: a frame, `n_frames` times, oldest first, and then what is there once.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObservationLayout {
    /// How often the frame is there; 1 where there is no history.
    pub n_frames: usize,
    /// The numbers of one frame.
    pub frame: Vec<Quantity>,
    /// The numbers after the frames.
    pub rest: Vec<Quantity>,
}

impl ObservationLayout {
    /// Describes an observation without a history.
    pub fn single(frame: Vec<Quantity>) -> Self {
        Self { n_frames: 1, frame, rest: Vec::new() }
    }

    /// Lists every number of the observation, in order; one of a history is named with its step, `t-3.x` to `t.x`.
    pub fn quantities(&self) -> Vec<Quantity> {
        let frames = (0..self.n_frames).rev().flat_map(|age| {
            let prefix = match (self.n_frames, age) {
                (1, _) => String::new(),
                (_, 0) => "t.".to_owned(),
                _ => format!("t-{age}."),
            };
            let name =
                move |it: &Quantity| Quantity { name: prefix.clone() + &it.name, ..it.clone() };
            self.frame.iter().map(name).collect::<Vec<_>>()
        });
        frames.chain(self.rest.iter().cloned()).collect()
    }
}

/// One head of an action, with what each of its choices means.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct NamedHead {
    /// The head's name, as in the action's specification.
    pub name: String,
    /// One name per choice.
    pub choices: Vec<String>,
}

/// One part of the reward.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RewardTerm {
    /// When it is paid, or per what.
    pub when: String,
    /// How much; a cost is negative.
    pub amount: f64,
    /// The setting that holds it.
    pub key: String,
}

impl RewardTerm {
    /// Describes what a setting pays.
    pub fn new(when: impl Into<String>, amount: f64, key: impl Into<String>) -> Self {
        Self { when: when.into(), amount, key: key.into() }
    }
}

/// What a task shows, offers and pays.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Description {
    /// The numbers of the observation.
    pub observation: ObservationLayout,
    /// The heads of the action, in order.
    pub actions: Vec<NamedHead>,
    /// The parts of the reward.
    pub rewards: Vec<RewardTerm>,
}

impl Description {
    /// Describes a task that says nothing of itself but its shapes.
    pub fn unnamed(spec: &EnvSpec) -> Self {
        let head = |head: &leadtime_proto::Head| NamedHead {
            name: head.name.clone(),
            choices: (0..head.n_choices).map(|choice| choice.to_string()).collect(),
        };
        Self {
            observation: ObservationLayout::single(Quantity::unnamed(spec.obs_dim)),
            actions: spec.actions.heads.iter().map(head).collect(),
            rewards: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_history_is_named_by_step_oldest_first() {
        let layout = ObservationLayout {
            n_frames: 3,
            frame: vec![Quantity::flag("on", "")],
            rest: vec![Quantity::flag("after", "")],
        };
        let names: Vec<String> = layout.quantities().into_iter().map(|it| it.name).collect();
        assert_eq!(names, ["t-2.on", "t-1.on", "t.on", "after"]);
        let single = ObservationLayout::single(vec![Quantity::flag("on", "")]);
        assert_eq!(single.quantities()[0].name, "on");
    }
}

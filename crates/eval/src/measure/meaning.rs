//! What each measure means, in a sentence; `docs/metrics.md` has the same words.

/// A measure's name and its meaning.
const MEANINGS: [(&str, &str); 57] = [
    ("success", "share of episodes in which the task was done as it should be"),
    (
        "averted",
        "share of episodes that succeed, of those in which the same listener fails when nobody speaks",
    ),
    (
        "harmed",
        "share of episodes that fail, of those in which the same listener succeeds when nobody speaks",
    ),
    ("notifications_per_step", "messages started, per step of the episode"),
    ("notifications", "messages started; ignored initiations are counted apart"),
    ("followed_of_initiated", "messages followed for at least one step, of those started"),
    ("followed_of_comprehended", "messages followed for at least one step, of those understood"),
    ("preempted_rate", "messages cut before they were understood, of those started"),
    (
        "overwritten_rate",
        "messages understood, and replaced before a single step of reaction, of those understood",
    ),
    ("long_rate", "messages of four words or more, of those started"),
    ("enter_danger", "share of episodes that were in a danger zone at any step"),
    ("return", "sum of the rewards of an episode"),
    ("length", "steps of an episode"),
    (
        "ignored_initiations",
        "attempts to start a message that were blocked, because one was running",
    ),
    ("comprehended", "messages heard up to their k-th word"),
    ("delivered", "messages heard to their last word"),
    ("unheeded", "messages understood that led to no action, because the world let none happen"),
    ("continued", "attempts to repeat the message under way, which change nothing"),
    ("mean_k", "words after which a message can be acted upon: mean over started messages"),
    ("mean_l", "words of a message: mean over started messages"),
    ("first_notification", "step in which the first message starts, counted from 1"),
    (
        "lead_time",
        "steps from the first message to what happens in the same episode when nobody speaks",
    ),
    ("first_l", "words of the episode's first message"),
    ("later_l", "words of the messages after the first"),
    (
        "per_step_before_hazard",
        "messages per step up to the step at which something happens when nobody speaks",
    ),
    ("per_step_after_hazard", "messages per step after it"),
    ("landed", "share of episodes that end with a soft landing, anywhere"),
    ("landed_on_pad", "share of episodes that end with a soft landing on the pad"),
    ("crashed", "share of episodes that end in a crash"),
    ("out", "share of episodes that end outside the view"),
    ("timed_out", "share of episodes that end at the time limit"),
    ("danger_steps", "steps inside a danger zone"),
    ("fuel", "fuel that the engines burnt, as it is taken off the return"),
    ("arrived", "share of drives that reach the goal"),
    ("in_time", "share of drives that reach the goal in time"),
    ("comfortable", "share of drives in which the driver never brakes too hard"),
    ("drive_time", "duration of the drive up to the arrival or the crash"),
    ("overtaken", "cars that the driver has overtaken"),
    ("refused_changes", "lane changes that were asked for and not possible"),
    ("mean_speed", "mean speed of the drive, in m/s"),
    ("hardest_braking", "strongest deceleration of the drive"),
    ("jerk", "root mean square of the change of acceleration: comfort"),
    ("return_collision", "part of the return that is for collisions"),
    ("return_right_lane", "part of the return that is for keeping right"),
    ("return_high_speed", "part of the return that is for speed"),
    ("return_merging", "part of the return that is for the speed of merging cars"),
    ("return_lane_change", "part of the return that is for changing lanes"),
    ("return_late", "part of the return that is for being late"),
    ("return_hard_braking", "part of the return that is for braking too hard"),
    ("dish_delivered", "share of episodes in which the dish was delivered, in time or not"),
    (
        "steps_to_deliver",
        "steps until the dish was delivered; the longest episode where it was not",
    ),
    ("excess_steps", "those steps beyond what a cook who sees everything needs"),
    ("redundant_steps", "steps spent on something that had been done or was not needed"),
    ("pointless_pickups", "things fetched in such steps"),
    ("ineffective_actions", "actions that changed nothing"),
    ("blocked_moves", "moves that a message asked for and that something blocked"),
    ("disclosures", "messages that told the cook what the stations hold"),
];

/// Returns what a measure means; `None` for one of a world of one's own.
pub fn meaning(name: &str) -> Option<&'static str> {
    MEANINGS.iter().find(|(known, _)| *known == name).map(|(_, meaning)| *meaning)
}

#[cfg(test)]
mod tests {
    use leadtime_proto::TaskSpec;

    use super::*;
    use crate::measure::summary::{is_share, known_measures, title};

    #[test]
    fn every_measure_of_the_built_in_worlds_is_explained_here_and_in_the_documents() {
        let registry = leadtime_worlds::builtin();
        for domain in registry.names() {
            let task = TaskSpec { domain: domain.to_owned(), settings: "{}".to_owned() };
            let environment = registry.build(&task).unwrap();
            for name in known_measures(&environment.spec().metrics) {
                assert!(meaning(&name).is_some(), "`{name}` of {domain}");
            }
        }
        let documented = include_str!("../../../../docs/metrics.md");
        for (name, meaning) in MEANINGS {
            let row = format!("| `{name}` | {} | {meaning} |\n", title(name));
            assert!(documented.contains(&row), "{row}");
            assert!(is_share(name) || !meaning.starts_with("share of "), "`{name}` is a share");
        }
    }
}

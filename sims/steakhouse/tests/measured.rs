//! What silent, informing and scripted notifiers come to, beside the same measured with another program.
//!
//! The expected means are those that `sims/steakhouse/tests/golden/steakhouse.py` prints, over 100 episodes with seeds of its own;
//! here are 400. `cargo test -p leadtime-steakhouse --test measured -- --nocapture` prints the table.

use std::collections::BTreeMap;

use leadtime_proto::EnvId;
use leadtime_sims::human::SpeechAct;
use leadtime_sims::{Domain as _, Environment as _, EpisodeSeed};
use leadtime_steakhouse::task::{SteakhouseTaskSettings, TieRule, golden};
use leadtime_steakhouse::world::StartFamily;

const EPISODES: u64 = 400;

/// Who speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Speaker {
    Silent,
    /// Nobody, and the cook knows what the stations hold from the start: the upper reference.
    Unneeded,
    InformAtStart,
    Heuristic,
}

impl Speaker {
    const ALL: [Self; 4] = [Self::Silent, Self::Unneeded, Self::InformAtStart, Self::Heuristic];
}

/// Means over episodes by the names of the metrics, and of the `return`.
type Averages = BTreeMap<String, f64>;

/// Plays episodes with one speaker, the same starts and ties for each.
fn play(settings: &SteakhouseTaskSettings, speaker: Speaker) -> Averages {
    let mut settings = settings.clone();
    settings.world.aware |= speaker == Speaker::Unneeded;
    let mut env = settings.build().expect("the settings are possible");
    let mut observation = vec![0.0; env.spec().obs_dim];
    let mut metrics = vec![0.0; env.spec().metrics.len()];
    let mut sums = Averages::new();
    for episode in 0..EPISODES {
        env.reset(EpisodeSeed { run_seed: 0, env_id: EnvId(0), episode }, &mut observation);
        loop {
            let script = match speaker {
                Speaker::InformAtStart => "inform_at_start",
                Speaker::Heuristic => "heuristic",
                Speaker::Silent | Speaker::Unneeded => "unaided",
            };
            let message = env.human().may_start().then(|| env.domain().script(script)).flatten();
            let act = message.map_or(SpeechAct::Continue, SpeechAct::Start);
            let (outcome, _) = env.step_with(act, &mut observation);
            *sums.entry("return".to_owned()).or_default() += f64::from(outcome.reward);
            if outcome.end.is_some() {
                break;
            }
        }
        env.metrics(&mut metrics);
        for (name, value) in env.spec().metrics.iter().zip(&metrics) {
            *sums.entry(name.clone()).or_default() += f64::from(*value);
        }
    }
    sums.into_iter().map(|(name, sum)| (name, sum / EPISODES as f64)).collect()
}

/// Compares all speakers in one family of starts, with a row for each.
fn compare(settings: &SteakhouseTaskSettings, family: StartFamily) -> [Averages; 4] {
    let mut settings = settings.clone();
    settings.world.start_families = vec![family];
    Speaker::ALL.map(|speaker| {
        let row = play(&settings, speaker);
        print(&format!("{}, {family:?}, {speaker:?}", settings.world.layout), &row);
        row
    })
}

/// The settings of the other program: as recorded, but with random ties.
fn settings(random_pose: bool) -> SteakhouseTaskSettings {
    let mut settings = golden();
    settings.world.ties = TieRule::Random;
    settings.world.random_pose = random_pose;
    settings
}

#[expect(clippy::print_stdout, reason = "a table, shown with --nocapture")]
fn print(name: &str, row: &Averages) {
    print!("{name:<34}");
    for column in ["success", "steps_to_deliver", "redundant_steps", "notifications", "return"] {
        print!("  {column} {:.2}", row[column]);
    }
    println!();
}

#[track_caller]
fn near(found: f64, expected: f64, within: f64) {
    assert!((found - expected).abs() <= within, "{found:.2}, expected {expected} within {within}");
}

#[test]
fn random_starts_cost_what_they_cost_in_the_other_program() {
    // Success, steps, redundant steps and return; fixed start tile, then anywhere.
    let rows = [
        (Speaker::Silent, false, [0.04, 60.5, 25.0, 3.9]),
        (Speaker::Silent, true, [0.23, 57.5, 20.8, 7.3]),
        (Speaker::Unneeded, false, [0.99, 38.9, 0.0, 21.7]),
        (Speaker::Unneeded, true, [0.99, 39.3, 0.0, 21.7]),
        (Speaker::InformAtStart, false, [0.94, 42.1, 2.3, 20.3]),
        (Speaker::InformAtStart, true, [0.95, 42.3, 2.8, 20.4]),
    ];
    for (speaker, random_pose, [success, steps, redundant, total]) in rows {
        let row = play(&settings(random_pose), speaker);
        print(&format!("{speaker:?}, random pose: {random_pose}"), &row);
        assert_eq!(row["dish_delivered"], 1.0);
        // About four standard errors of the difference of both means.
        near(row["success"], success, 0.15);
        near(row["steps_to_deliver"], steps, 4.5);
        near(row["redundant_steps"], redundant, 3.5);
        near(row["return"], total, 3.5);
    }
}

#[test]
fn every_family_of_starts_costs_what_it_costs_in_the_other_program() {
    // Steps of the silent and of the true belief, and things fetched in vain.
    let rows = [
        (StartFamily::Empty, [71.5, 71.5, 0.0]),
        (StartFamily::Grills, [66.5, 53.7, 1.0]),
        (StartFamily::Boards, [75.7, 57.5, 1.0]),
        (StartFamily::Sinks, [64.7, 55.5, 0.5]),
        (StartFamily::FirstOfEach, [60.0, 35.4, 2.5]),
        (StartFamily::AllPartial, [60.7, 33.4, 2.3]),
        (StartFamily::AllReady, [52.9, 25.5, 2.3]),
    ];
    for (family, [silent, informed, pickups]) in rows {
        let found = compare(&settings(false), family);
        near(found[0]["steps_to_deliver"], silent, 2.0);
        near(found[1]["steps_to_deliver"], informed, 1.0);
        near(found[0]["pointless_pickups"], pickups, 0.2);
    }
}

#[test]
fn with_the_default_listener_speaking_is_better_than_silence() {
    for family in [StartFamily::Random, StartFamily::AllPartial] {
        let [silent, unneeded, informing, heuristic] =
            compare(&SteakhouseTaskSettings::default(), family);
        assert!(
            silent["success"] < informing["success"] && silent["success"] < heuristic["success"]
        );
        assert!(
            silent["steps_to_deliver"] > informing["steps_to_deliver"]
                && silent["steps_to_deliver"] > heuristic["steps_to_deliver"]
        );
        assert!(unneeded["success"] > 0.95 && informing["notifications"] == 1.0);
        assert!(heuristic["redundant_steps"] < silent["redundant_steps"]);
    }
}

#[test]
fn stations_in_somebody_elses_use_cost_steps_only_where_the_others_are_far() {
    let cost = |layout: &str| {
        let mut settings = SteakhouseTaskSettings::default();
        settings.world.layout = layout.to_owned();
        let rows = compare(&settings, StartFamily::Unavailable);
        [
            rows[0]["steps_to_deliver"] - rows[1]["steps_to_deliver"],
            rows[2]["steps_to_deliver"] - rows[1]["steps_to_deliver"],
        ]
    };
    let [silent, informed] = cost("wings");
    // Measured: 3.8 steps, and 0.2 for a cook who is informed at the start; there is no other program to compare with.
    assert!(silent > 2.5 && informed < 0.6 * silent, "{silent} {informed}");
    let [silent, _] = cost("ring");
    assert!(silent < 1.0, "{silent}");
}

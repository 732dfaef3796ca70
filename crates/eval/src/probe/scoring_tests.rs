//! A delay that the features hold is found; noise is not mistaken for it.

use leadtime_sims::Environment;
use leadtime_sims::classic::{CartPole, CartPoleSettings};

use super::super::synthetic::{Revealed, Synthetic, make, player};
use super::*;

const BOOTSTRAP: Bootstrap = Bootstrap { seed: 3, n_resamples: 199, confidence: 0.95 };

fn settings() -> PlaySettings<'static> {
    PlaySettings::new(300, 11)
}

fn known(told: Revealed) -> ProbeResult {
    probe(&make(told), &player(), &settings(), BOOTSTRAP).unwrap()
}

/// Places of the readers.
const CONSTANT: usize = 0;
const PER_STAGE: usize = 1;
const INPUT: usize = 2;
const HIDDEN: usize = 3;

/// Samples of which the hidden features hold the delay, and the input does not.
fn telling() -> Vec<ProbeSample> {
    let mut draws = leadtime_numerics::Pcg64::seed_from_u64(2);
    let mut sample = |episode: u64, stage: usize, delay: u32| {
        let mut noise = || draws.normal() as f32;
        let input = (0..20).map(|_| noise()).collect();
        let mut hidden: Vec<f32> = (0..20).map(|_| noise()).collect();
        hidden[4] = 0.5 - 0.1 * delay as f32;
        let weight = 1.0 / 3.0;
        ProbeSample { episode, stage, delay, input, hidden, weight, n_steps: 9, comprehended: 1 }
    };
    let delay = |episode: u64| (episode * 7 % 6) as u32;
    (0..120).flat_map(|i| [0, 1, 2].map(|stage| sample(i, stage, delay(i)))).collect()
}

#[test]
fn features_that_hold_the_delay_are_found_out_exactly() {
    let samples = telling();
    let (seen, unseen): (Vec<&ProbeSample>, Vec<&ProbeSample>) =
        samples.iter().partition(|sample| sample.episode < 60);
    let scorer = Scorer::new(&seen, unseen, BOOTSTRAP).unwrap();
    let overall = scorer.overall();
    assert!(overall.scores[HIDDEN].error.estimate < 1e-2, "{overall:?}");
    let exact = overall.scores[HIDDEN].exact;
    assert!(exact.estimate == 1.0 && exact.low < 1.0, "a share of all has width: {exact:?}");
    assert!(overall.scores[CONSTANT].error.estimate > 1.4);
    assert!(scorer.readers()[HIDDEN].r_squared > Some(0.999));
    assert!(scorer.differences().iter().all(|difference| difference.interval.high < -1.0));
    // Noise is no better than always predicting the mean.
    assert!(scorer.readers()[INPUT].r_squared < Some(0.05), "{:?}", scorer.readers());
    assert!(overall.scores[INPUT].error.high > overall.scores[CONSTANT].error.low);
}

#[test]
fn a_policy_that_is_shown_the_delay_holds_it_from_then_on() {
    let known = known(Revealed::AfterTheFirstReaction);
    assert_eq!((known.n_learned_from, known.n_evaluated_on), (150, 150));
    let error = |stage: usize, reader: usize| known.stages[stage].scores[reader].error.estimate;
    for stage in 1..N_STAGES {
        let [input, hidden] = [INPUT, HIDDEN].map(|reader| error(stage, reader));
        assert!(input < 0.3 && hidden < 0.6, "stage {stage}: {input}, {hidden}");
        assert!(error(stage, CONSTANT) > 1.1 && error(stage, PER_STAGE) > 1.1);
    }
    // Before, nobody knows.
    assert!(error(0, HIDDEN) > 1.2, "{}", error(0, HIDDEN));
    assert!(known.readers[HIDDEN].r_squared > Some(0.6), "{:?}", known.readers);
    assert_eq!(known.readers.iter().map(|r| r.n_features).collect::<Vec<_>>(), [0, 0, 8, 32 + 24]);
    // The seed decides, and threads change nothing.
    let make = make(Revealed::AfterTheFirstReaction);
    let run = |settings| probe(&make, &player(), &settings, BOOTSTRAP).unwrap();
    assert_eq!(run(settings().threads(3)), known);
    assert_ne!(run(PlaySettings::new(300, 12)), known);
}

#[test]
fn noise_is_no_better_than_a_constant_and_rare_stages_are_not_scored() {
    let known = known(Revealed::Nothing);
    for reader in [INPUT, HIDDEN] {
        let score = &known.readers[reader];
        assert!(score.r_squared < Some(0.05), "{score:?}");
        let error = &known.overall.scores[reader].error;
        assert!(error.high > known.overall.scores[CONSTANT].error.low, "{error:?}");
    }
    let names: Vec<&str> = known.stages.iter().map(|stage| stage.name.as_str()).collect();
    assert_eq!(names, ["0", "1", "2", "3", "4", "5 or more"]);
    // One episode in nine ends with each further stage; the last one is of the steps after the fifth reaction.
    assert_eq!((known.stages[0].n_evaluated_on, known.stages[0].n_steps), (150, 600));
    assert!((80..130).contains(&known.stages[3].n_evaluated_on));
    assert!(known.stages[5].n_steps > 4 * known.stages[5].n_evaluated_on as u64);
    assert_eq!(known.stages[3].mean_comprehended, Some(3.0));
    let few = PlaySettings::new(50, 11);
    let few = probe(&make(Revealed::Nothing), &player(), &few, BOOTSTRAP).unwrap();
    assert!(few.stages[0].scores.len() == 4 && few.stages[5].scores.is_empty());
    assert!(few.text().contains("\u{2013}"), "{}", few.text());
}

#[test]
fn unknown_values_are_named_in_one_sentence() {
    let refuse = |make: &MakeEnvironment<'_>, player: &Player, n_episodes| {
        let settings = PlaySettings::new(n_episodes, 11);
        probe(make, player, &settings, BOOTSTRAP).unwrap_err().to_string()
    };
    let of_world = |change: fn(&mut Synthetic)| {
        let make = || {
            let mut world = Synthetic::new(Revealed::Nothing);
            change(&mut world);
            Ok(Box::new(world) as Box<dyn Environment>)
        };
        refuse(&make, &player(), 40)
    };
    let text = of_world(|world| world.most = 0);
    assert!(text.starts_with("the listener's reaction delay is 0 in every episode"), "{text}");
    assert!(text.contains("{uniform={low=0,high=5,drawn=\"per_episode\"}}"), "{text}");
    assert!(of_world(|world| world.fickle = true).contains("for every message"));
    let text = refuse(&make(Revealed::Nothing), &player(), 39);
    assert_eq!(text, "39 episodes are too few for a probe; allowed: at least 40");
    let pole = || {
        let pole = CartPole::new(&CartPoleSettings::default())?;
        Ok(Box::new(pole) as Box<dyn Environment>)
    };
    let text = refuse(&pole, &player(), 40);
    assert!(text.starts_with("the policy takes 8 observations"), "{text}");
}

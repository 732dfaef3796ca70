//! Environments together give the bits of environments apart; a snapshot goes on as if nothing had happened.

use leadtime_policy::Parameters;
use leadtime_proto::{PolicySpec, Schedule, TaskSpec};
use leadtime_sims::classic::{CartPole, CartPoleSettings};

use super::*;

const N_STEPS: u32 = 40;

fn spec() -> RunSpec {
    let env = cart_pole().spec().clone();
    RunSpec {
        seed: 5,
        task: TaskSpec { domain: "cartpole".to_owned(), settings: "{}".to_owned() },
        policy: PolicySpec::dense(&env, &[16, 16]),
        env,
        n_steps: N_STEPS,
        schedule: Schedule::Lag(0),
    }
}

/// Short episodes: some end by falling, some by the time limit.
fn cart_pole() -> Box<dyn Environment> {
    Box::new(CartPole::new(&CartPoleSettings { max_steps: 15 }).unwrap())
}

fn policy() -> Policy {
    let spec = spec().policy;
    Policy::new(&spec, &Parameters::initialize(&spec, 9).unwrap()).unwrap()
}

fn beginning(env_id: u32) -> EnvAssignment {
    EnvAssignment { env_id: EnvId(env_id), iteration: Iteration(0), snapshot: Vec::new() }
}

fn worker(assignments: &[EnvAssignment]) -> Worker {
    let mut worker = Worker::new(spec());
    for assignment in assignments {
        worker.insert(cart_pole(), assignment).unwrap();
    }
    worker
}

fn collect(worker: &mut Worker) -> Vec<Rollout> {
    worker.collect(&mut policy(), PolicyVersion(3), &mut ()).to_vec()
}

#[test]
fn a_rollout_is_what_the_learner_expects() {
    let mut worker = worker(&[beginning(0), beginning(1)]);
    for iteration in [0, 1].map(Iteration) {
        for rollout in collect(&mut worker) {
            let rollout = rollout.check(&spec().env, N_STEPS as usize, 0).unwrap();
            assert_eq!((rollout.iteration, rollout.version), (iteration, PolicyVersion(3)));
        }
    }
}

#[test]
fn environments_together_give_the_bits_of_environments_apart() {
    let ids: Vec<EnvAssignment> = (0..5).map(beginning).collect();
    let mut together = worker(&ids);
    let mut apart: Vec<Worker> = ids.iter().map(|id| worker(std::slice::from_ref(id))).collect();
    for _ in 0..3 {
        let expected: Vec<Rollout> = apart.iter_mut().flat_map(collect).collect();
        assert_eq!(collect(&mut together), expected);
        assert_ne!(expected[0].observations, expected[1].observations);
    }
}

#[test]
fn an_environment_continues_elsewhere_from_its_snapshot() {
    let mut here = worker(&[beginning(2)]);
    let first = collect(&mut here).remove(0);
    let (iteration, snapshot) = (Iteration(1), first.snapshot.clone());
    let moved = EnvAssignment { iteration, snapshot, ..beginning(2) };
    let second = collect(&mut here).remove(0);
    assert_eq!(first.next_observation, second.observations[..4], "they join without a seam");
    assert_eq!(first.next_value, second.values[0]);
    let mut there = worker(&[moved, beginning(0)]);
    assert_eq!(there.next_iteration(), Some(Iteration(0)));
    assert_eq!(collect(&mut there)[0].env_id, EnvId(0), "the lowest iteration comes first");
    there.retain(&[EnvId(2)]);
    assert_eq!(collect(&mut there), [second]);
    for _ in 0..2 {
        assert_eq!(collect(&mut there), collect(&mut here));
    }
}

#[test]
fn ends_come_with_their_values_and_summaries() {
    let mut worker = worker(&[beginning(0), beginning(1), beginning(2)]);
    let rollouts: Vec<Rollout> = (0..3).flat_map(|_| collect(&mut worker)).collect();
    let ends: Vec<&EpisodeEnd> = rollouts.iter().flat_map(|rollout| &rollout.ends).collect();
    let (truncated, fallen): (Vec<&EpisodeEnd>, Vec<&EpisodeEnd>) =
        ends.iter().partition(|end| end.truncated);
    assert!(!truncated.is_empty() && !fallen.is_empty(), "the test needs both kinds of end");
    assert!(fallen.iter().all(|end| end.final_value == 0.0));
    for end in truncated {
        let mut value = [0.0];
        policy().values_only(&end.final_observation, &[], &mut value);
        assert_eq!(end.final_value, value[0]);
        assert_eq!((end.summary.length, end.summary.episode_return), (15, 15.0));
    }
    let own = rollouts.iter().filter(|rollout| rollout.env_id == EnvId(1));
    let ends = own.flat_map(|rollout| &rollout.ends);
    assert!((0..).zip(ends).all(|(n, end)| end.summary.episode == n));
}

#[test]
fn after_a_lost_snapshot_no_episode_is_played_again() {
    let mut worker = worker(&[beginning(0)]);
    let played: Vec<Rollout> = (0..3).flat_map(|_| collect(&mut worker)).collect();
    let last = played[2].ends.last().unwrap().summary.episode;
    assert!(last > 3, "more episodes than rollouts");
    worker.insert(cart_pole(), &EnvAssignment { iteration: Iteration(3), ..beginning(0) }).unwrap();
    let fresh = collect(&mut worker).remove(0);
    assert!(fresh.ends[0].summary.episode > last + 1, "nor the one that was lost");
}

#[test]
fn time_is_measured_by_the_callers_stopwatch() {
    struct Laps(Vec<Phase>);
    impl Stopwatch for Laps {
        fn lap(&mut self, phase: Phase) {
            self.0.push(phase);
        }
    }
    let mut laps = Laps(Vec::new());
    worker(&[beginning(0)]).collect(&mut policy(), PolicyVersion(0), &mut laps);
    // Two phases of every step and of the boundary, and two wherever an episode ends.
    assert!(laps.0.len() > 2 * N_STEPS as usize + 2);
    assert!(laps.0.chunks(2).all(|phases| phases == [Phase::Infer, Phase::Simulate]));
}

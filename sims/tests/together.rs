//! Stepping in a batch equals stepping one by one, bit for bit, in every domain.

use leadtime_numerics::Pcg64;
use leadtime_proto::{EnvId, TaskSpec};
use leadtime_sims::{EpisodeSeed, Registry, Vectorized};

const N_ENVS: usize = 3;
const N_STEPS: usize = 250;

#[test]
fn a_batch_equals_its_rows_alone() {
    for domain in ["lander", "highway", "steakhouse"] {
        let task = TaskSpec { domain: domain.to_owned(), settings: "{}".to_owned() };
        let build = || Registry::builtin().build(&task).expect("the default task can be built");
        let seed = |row, episode| EpisodeSeed { run_seed: 5, env_id: EnvId(row as u32), episode };
        let mut together = Vectorized::new((0..N_ENVS).map(|_| build()).collect());
        let mut alone: Vec<_> = (0..N_ENVS).map(|_| build()).collect();
        let mut observation = vec![0.0; alone[0].spec().obs_dim];
        let heads: Vec<usize> =
            alone[0].spec().actions.heads.iter().map(|head| head.n_choices).collect();
        let mut episodes = [0; N_ENVS];
        for (row, environment) in alone.iter_mut().enumerate() {
            together.reset(row, seed(row, 0));
            environment.reset(seed(row, 0), &mut observation);
            assert_eq!(together.observation(row), observation, "{domain}");
        }
        let mut generator = Pcg64::seed_from_u64(1);
        for _ in 0..N_STEPS {
            let draw = |&n: &usize| generator.below(n) as u8;
            let actions: Vec<u8> =
                std::iter::repeat_n(&heads, N_ENVS).flatten().map(draw).collect();
            together.step(&actions);
            for (row, environment) in alone.iter_mut().enumerate() {
                let action = &actions[row * heads.len()..][..heads.len()];
                let outcome = environment.step(action, &mut observation);
                assert_eq!(together.outcomes()[row], outcome, "{domain}");
                assert_eq!(together.observation(row), observation, "{domain}");
                if outcome.end.is_some() {
                    episodes[row] += 1;
                    environment.reset(seed(row, episodes[row]), &mut observation);
                    together.reset(row, seed(row, episodes[row]));
                }
            }
        }
        assert!(episodes.iter().sum::<u64>() > 0, "{domain}: an episode ends on the way");
    }
}

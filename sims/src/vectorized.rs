//! Many environments stepped as one: rows in, rows out, in buffers that are reused.
//!
//! ```text
//! observations [N, D]   masks [N]   --policy-->   actions [N, H]   --step-->   outcomes [N], observations [N, D]
//! ```
//!
//! A row whose episode ended keeps its final observation until [`Vectorized::reset`] starts its next episode, so
//! whoever drives it sees both. Rows do not influence each other: stepping them together equals stepping each
//! alone, bit for bit.

use leadtime_proto::Mask;

use crate::environment::{Environment, EpisodeSeed, SnapshotError, StepOutcome};

/// A set of environments of one specification.
pub struct Vectorized {
    environments: Vec<Box<dyn Environment>>,
    obs_dim: usize,
    n_heads: usize,
    observations: Vec<f32>,
    masks: Vec<Mask>,
    outcomes: Vec<StepOutcome>,
}

impl std::fmt::Debug for Vectorized {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Vectorized")
            .field("n_envs", &self.environments.len())
            .field("obs_dim", &self.obs_dim)
            .finish_non_exhaustive()
    }
}

impl Vectorized {
    /// Joins environments; each must be reset or restored before the first step.
    ///
    /// # Panics
    ///
    /// If there is none, or if two differ in their specification.
    pub fn new(environments: Vec<Box<dyn Environment>>) -> Self {
        let spec = environments.first().expect("there is at least one environment").spec();
        assert!(environments.iter().all(|e| e.spec() == spec), "all rows are of one task");
        let (obs_dim, n_heads) = (spec.obs_dim, spec.actions.heads.len());
        let n_envs = environments.len();
        Self {
            environments,
            obs_dim,
            n_heads,
            observations: vec![0.0; n_envs * obs_dim],
            masks: vec![Mask::ALL; n_envs],
            outcomes: vec![StepOutcome { reward: 0.0, end: None }; n_envs],
        }
    }

    /// Returns N.
    pub fn n_envs(&self) -> usize {
        self.environments.len()
    }

    /// Returns what each row looks like now. Shape `[N, D]`.
    pub fn observations(&self) -> &[f32] {
        &self.observations
    }

    /// Returns one row's observation. Shape `[D]`.
    pub fn observation(&self, row: usize) -> &[f32] {
        &self.observations[row * self.obs_dim..][..self.obs_dim]
    }

    /// Returns what each row offers now. Shape `[N]`.
    pub fn masks(&self) -> &[Mask] {
        &self.masks
    }

    /// Returns what the last step gave each row. Shape `[N]`.
    pub fn outcomes(&self) -> &[StepOutcome] {
        &self.outcomes
    }

    /// Returns one row's environment, for its metrics, snapshot or scene.
    pub fn environment(&self, row: usize) -> &dyn Environment {
        &*self.environments[row]
    }

    /// Starts the next episode of one row.
    pub fn reset(&mut self, row: usize, seed: EpisodeSeed) {
        let observation = &mut self.observations[row * self.obs_dim..][..self.obs_dim];
        self.environments[row].reset(seed, observation);
        self.masks[row] = self.environments[row].mask();
    }

    /// Continues one row from a snapshot.
    ///
    /// # Errors
    ///
    /// [`SnapshotError`] if the bytes are no snapshot of such an environment; the row must then be reset.
    pub fn restore(&mut self, row: usize, snapshot: &[u8]) -> Result<(), SnapshotError> {
        let observation = &mut self.observations[row * self.obs_dim..][..self.obs_dim];
        self.environments[row].restore(snapshot, observation)?;
        self.masks[row] = self.environments[row].mask();
        Ok(())
    }

    /// Takes one step in every row. Shape of `actions`: `[N, H]`.
    ///
    /// # Panics
    ///
    /// If `actions` has another shape.
    pub fn step(&mut self, actions: &[u8]) {
        let n_choices = self.n_envs() * self.n_heads;
        assert_eq!(actions.len(), n_choices, "one choice per head and environment");
        let rows = self.observations.chunks_exact_mut(self.obs_dim).enumerate();
        for (row, observation) in rows {
            let action = &actions[row * self.n_heads..][..self.n_heads];
            let environment = &mut self.environments[row];
            self.outcomes[row] = environment.step(action, observation);
            self.masks[row] = environment.mask();
        }
    }
}

#[cfg(test)]
mod tests {
    use leadtime_numerics::Pcg64;
    use leadtime_proto::EnvId;

    use super::*;
    use crate::classic::{CartPole, CartPoleSettings};

    fn seed(row: usize, episode: u64) -> EpisodeSeed {
        EpisodeSeed { run_seed: 5, env_id: EnvId(row as u32), episode }
    }

    fn cartpole() -> Box<dyn Environment> {
        Box::new(CartPole::new(&CartPoleSettings::default()).unwrap())
    }

    #[test]
    fn stepping_together_equals_stepping_alone() {
        let mut together = Vectorized::new((0..3).map(|_| cartpole()).collect());
        let mut alone: Vec<_> = (0..3).map(|_| (cartpole(), [0.0; 4], 0)).collect();
        for (row, (environment, observation, _)) in alone.iter_mut().enumerate() {
            together.reset(row, seed(row, 0));
            environment.reset(seed(row, 0), observation);
        }
        let mut generator = Pcg64::seed_from_u64(1);
        for _ in 0..200 {
            let actions: [u8; 3] = std::array::from_fn(|_| generator.below(2) as u8);
            together.step(&actions);
            for (row, (environment, observation, episode)) in alone.iter_mut().enumerate() {
                let outcome = environment.step(&[actions[row]], observation);
                assert_eq!(together.outcomes()[row], outcome);
                assert_eq!(together.observation(row), observation);
                if outcome.end.is_some() {
                    *episode += 1;
                    environment.reset(seed(row, *episode), observation);
                    together.reset(row, seed(row, *episode));
                    assert_eq!(together.observation(row), observation);
                }
            }
        }
        assert!(alone.iter().all(|(_, _, episode)| *episode > 2));
    }

    #[test]
    fn a_row_continues_from_a_snapshot() {
        let mut rows = Vectorized::new((0..2).map(|_| cartpole()).collect());
        rows.reset(0, seed(0, 0));
        rows.reset(1, seed(1, 0));
        rows.step(&[1, 0]);
        let mut bytes = Vec::new();
        rows.environment(0).snapshot(&mut bytes);
        rows.restore(1, &bytes).unwrap();
        rows.step(&[1, 1]);
        assert_eq!(rows.observation(0), rows.observation(1));
    }
}

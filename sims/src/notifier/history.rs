//! The last n (observation, action) pairs, oldest first: what a notifier knows of the past.
//!
//! The pair of step t is the observation that is acted on now and the action that led to it. At the start of an
//! episode every pair is the first observation with a silent action, so no place is ever empty.

/// A window over the last pairs.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct History {
    /// Each an observation with the action before it, the oldest first. `[n_pairs, pair_dim]`
    pairs: Vec<f32>,
    obs_dim: usize,
    pair_dim: usize,
}

impl History {
    pub(super) fn new(n_pairs: usize, obs_dim: usize, action_dim: usize) -> Self {
        let pair_dim = obs_dim + action_dim;
        Self { pairs: vec![0.0; n_pairs * pair_dim], obs_dim, pair_dim }
    }

    pub(super) fn n_pairs(&self) -> usize {
        self.pairs.len() / self.pair_dim
    }

    pub(super) fn obs_dim(&self) -> usize {
        self.obs_dim
    }

    /// Forgets the past; `observe` writes the first observation.
    pub(super) fn begin(&mut self, observe: impl FnOnce(&mut [f32])) {
        self.pairs.fill(0.0);
        let (first, rest) = self.pairs.split_at_mut(self.pair_dim);
        observe(&mut first[..self.obs_dim]);
        for pair in rest.chunks_exact_mut(self.pair_dim) {
            pair.copy_from_slice(first);
        }
    }

    /// Moves on by one step: the oldest pair goes, and the new one is written in two parts.
    pub(super) fn push(
        &mut self,
        observe: impl FnOnce(&mut [f32]),
        encode_action: impl FnOnce(&mut [f32]),
    ) {
        self.pairs.copy_within(self.pair_dim.., 0);
        let newest = self.pairs.len() - self.pair_dim;
        let (observation, action) = self.pairs[newest..].split_at_mut(self.obs_dim);
        observe(observation);
        encode_action(action);
    }

    pub(super) fn row(&self) -> &[f32] {
        &self.pairs
    }

    /// Returns the newest observation and the one before it; a history of one pair has the same twice.
    pub(super) fn last_two(&self) -> (&[f32], &[f32]) {
        let newest = self.pairs.len() - self.pair_dim;
        let before = newest.saturating_sub(self.pair_dim);
        (&self.pairs[newest..][..self.obs_dim], &self.pairs[before..][..self.obs_dim])
    }

    /// Takes over a stored row; `false` if it is of another length.
    pub(super) fn restore(&mut self, row: &[f32]) -> bool {
        let fits = row.len() == self.pairs.len();
        if fits {
            self.pairs.copy_from_slice(row);
        }
        fits
    }
}

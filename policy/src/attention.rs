//! The heart of ego attention: how much the ego heeds each entity, and what it takes from it.
//!
//! One code for acting and learning, with sums in a fixed order: the same bits in both, whatever else is in a batch.
//!
//! ```text
//! score_i = q · k_i / √d   (-1e9 where the entity is not there)      p = softmax(score)      out = Σ p_i v_i
//! ```
//!
//! per head, on its share of d numbers of query, keys, values and output.
//!
//! # Source
//!
//! Leurent and Mercat, *Social Attention for Autonomous Decision-Making in Dense Traffic* (arXiv:1911.12250);
//! rl-agents (84df15ea), `EgoAttention`.

use leadtime_numerics::tanh::exp;

/// The score of an entity that is not there.
const ABSENT: f32 = -1e9;
/// Least presence of an entity that is there.
const PRESENT: f32 = 0.5;
/// Terms of a sum that are added side by side.
const LANES: usize = 8;

/// Sizes of an attention.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attention {
    /// Entities, N.
    pub n_entities: usize,
    /// Width, D.
    pub width: usize,
    /// Heads, H; they share out the width.
    pub n_heads: usize,
}

impl Attention {
    /// Tells whether an entity of this presence is there.
    pub fn is_present(presence: f32) -> bool {
        presence >= PRESENT
    }

    /// Returns the factor of scores, 1 / √d.
    pub fn scale(&self) -> f32 {
        1.0 / (self.head_width() as f32).sqrt()
    }

    /// Returns d, a head's share of the width.
    pub fn head_width(&self) -> usize {
        self.width / self.n_heads
    }

    /// Computes how much each head of one ego heeds each entity.
    ///
    /// # Shapes
    ///
    /// `query`: `[D]`; `keys`: `[N, D]`; `presence`: `[N]`; `shares`: `[H, N]`.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn shares(&self, query: &[f32], keys: &[f32], presence: &[f32], shares: &mut [f32]) {
        assert_eq!(presence.len(), self.n_entities, "`presence` must be [N]");
        assert_eq!(keys.len(), self.n_entities * self.width, "`keys` must be [N, D]");
        assert_eq!(shares.len(), self.n_heads * self.n_entities, "`shares` must be [H, N]");
        let (d, scale) = (self.head_width(), self.scale());
        let heads = query.chunks_exact(d).zip(shares.chunks_exact_mut(self.n_entities));
        for (head, (query, shares)) in heads.enumerate() {
            let entities = keys.chunks_exact(self.width).zip(presence);
            for (share, (key, &presence)) in shares.iter_mut().zip(entities) {
                let score = dot(query, &key[head * d..][..d]) * scale;
                *share = if Self::is_present(presence) { score } else { ABSENT };
            }
            softmax(shares);
        }
    }

    /// Adds up what one ego takes from the entities.
    ///
    /// # Shapes
    ///
    /// `shares`: `[H, N]`; `values`: `[N, D]`; `out`: `[D]`.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn gather(&self, shares: &[f32], values: &[f32], out: &mut [f32]) {
        assert_eq!(shares.len(), self.n_heads * self.n_entities, "`shares` must be [H, N]");
        assert_eq!(values.len(), self.n_entities * self.width, "`values` must be [N, D]");
        assert_eq!(out.len(), self.width, "`out` must be [D]");
        let d = self.head_width();
        out.fill(0.0);
        let heads = shares.chunks_exact(self.n_entities).zip(out.chunks_exact_mut(d));
        for (head, (shares, out)) in heads.enumerate() {
            for (share, value) in shares.iter().zip(values.chunks_exact(self.width)) {
                for (sum, value) in out.iter_mut().zip(&value[head * d..][..d]) {
                    *sum += share * value;
                }
            }
        }
    }
}

/// Adds up products in a fixed order: in lanes, then over lanes, then what is left.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    let (parts_a, parts_b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest = parts_a.remainder().iter().zip(parts_b.remainder());
    for (a, b) in parts_a.zip(parts_b) {
        for ((lane, a), b) in lanes.iter_mut().zip(a).zip(b) {
            *lane += a * b;
        }
    }
    rest.fold(lanes.iter().sum(), |sum, (a, b)| sum + a * b)
}

fn softmax(scores: &mut [f32]) {
    let highest = scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let mut total = 0.0;
    for score in &mut *scores {
        *score = exp(*score - highest);
        total += *score;
    }
    for score in scores {
        *score /= total;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absent_entities_get_no_share() {
        let attention = Attention { n_entities: 3, width: 2, n_heads: 2 };
        let keys = [1.0, 0.0, 0.0, 2.0, 9.0, 9.0];
        let mut shares = [f32::NAN; 6];
        attention.shares(&[1.0, 1.0], &keys, &[1.0, 1.0, 0.0], &mut shares);
        let e = 1.0_f32.exp();
        let expected =
            [e / (e + 1.0), 1.0 / (e + 1.0), 0.0, 1.0 / (1.0 + e * e), e * e / (1.0 + e * e), 0.0];
        for (share, expected) in shares.iter().zip(expected) {
            assert!((share - expected).abs() < 1e-6, "{shares:?}");
        }
        let mut out = [f32::NAN; 2];
        attention.gather(&shares, &[10.0, 0.0, 0.0, 5.0, 100.0, 100.0], &mut out);
        assert!(
            (out[0] - 10.0 * expected[0]).abs() < 1e-5 && (out[1] - 5.0 * expected[4]).abs() < 1e-5
        );
        // Nobody there, not even the ego: all are alike.
        attention.shares(&[1.0, 1.0], &keys, &[0.0; 3], &mut shares);
        assert!(shares.iter().all(|share| (share - 1.0 / 3.0).abs() < 1e-6), "{shares:?}");
    }

    #[test]
    fn ragged_heads_are_summed_whole() {
        let a: Vec<f32> = (0..11).map(|i| i as f32).collect();
        assert_eq!(dot(&a, &a), 385.0);
    }
}

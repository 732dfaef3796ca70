//! How much attention the ego pays to each entity, and what it takes from it.
//!
//! Acting and learning share this code. Its sums have a fixed order, so both get the same bits, whatever else is in a
//! batch.
//!
//! ```text
//! score_i = q · k_i / √d   (-1e9 where the entity is absent)      p = softmax(score)      out = Σ p_i v_i
//! ```
//!
//! per head, on its share of d numbers of query, keys, values and output. There is one query per frame, so keys and
//! values need not be computed entity by entity:
//!
//! ```text
//! q = Q e    k_i = K e_i    v_i = V e_i       q · k_i = (Kᵀ Q e) · e_i       C Σ p_i v_i = (C V) Σ p_i e_i
//! ```
//!
//! with C the output's map; what is in brackets is one vector per head and frame. Absent entities are not even
//! embedded ([`super::presence`]): their share is 0.
//!
//! # Source
//!
//! Leurent and Mercat, *Social Attention for Autonomous Decision-Making in Dense Traffic* (arXiv:1911.12250);
//! rl-agents (84df15ea), `EgoAttention`.

use leadtime_numerics::elementary::exp;

use super::presence::FramePresence;

/// The score of an absent entity.
const ABSENT: f32 = -1e9;
/// Terms of a sum that are added side by side.
const LANES: usize = 8;

/// Sizes of an attention.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attention {
    /// Width of embeddings, W.
    pub width: usize,
    /// Heads, H; they share out the width of queries, keys and values.
    pub n_heads: usize,
}

impl Attention {
    /// Returns the factor of scores, 1 / √d.
    pub fn scale(&self) -> f32 {
        1.0 / (self.head_width() as f32).sqrt()
    }

    /// Returns d, a head's share of the width.
    pub fn head_width(&self) -> usize {
        self.width / self.n_heads
    }

    /// Returns the rows of a map `[W, W]` that belong to a head, transposed: `[W, d]`.
    pub fn rows_of_head(&self, map: &[f32], head: usize) -> Vec<f32> {
        let (width, d) = (self.width, self.head_width());
        (0..width * d).map(|i| map[(head * d + i % d) * width + i / d]).collect()
    }

    /// Returns the columns of a map `[W, W]` that belong to a head: `[W, d]`.
    pub fn columns_of_head(&self, map: &[f32], head: usize) -> Vec<f32> {
        let d = self.head_width();
        map.chunks_exact(self.width).flat_map(|row| &row[head * d..][..d]).copied().collect()
    }

    /// Computes the share of attention that each head of one ego pays to each of the n + 1 present entities.
    ///
    /// # Shapes
    ///
    /// `queries`: `[H, W]`, to be compared with embeddings; `ego`: `[W]`; `others`: `[n, W]`; `shares`: `[H, 1 + n]`,
    /// the ego first.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn shares(
        &self,
        queries: &[f32],
        ego: &[f32],
        others: &[f32],
        presence: FramePresence,
        shares: &mut [f32],
    ) {
        assert_eq!(queries.len(), self.n_heads * self.width, "`queries` must be [H, W]");
        assert_eq!(ego.len(), self.width, "`ego` must be [W]");
        assert_eq!(others.len(), presence.n_others * self.width, "`others` must be [n, W]");
        let n_shares = self.n_heads * presence.n_entities();
        assert_eq!(shares.len(), n_shares, "`shares` must be [H, 1 + n]");
        let scale = self.scale();
        let heads = queries.chunks_exact(self.width);
        for (query, shares) in heads.zip(shares.chunks_exact_mut(presence.n_entities())) {
            let score = |is_present, embedding| {
                if is_present { dot(query, embedding) * scale } else { ABSENT }
            };
            shares[0] = score(presence.ego, ego);
            for (share, other) in shares[1..].iter_mut().zip(others.chunks_exact(self.width)) {
                *share = score(presence.others, other);
            }
            softmax(shares);
        }
    }

    /// Adds up embeddings, weighted by the shares of one ego.
    ///
    /// # Shapes
    ///
    /// `shares`: `[H, 1 + n]`; `ego`: `[W]`; `others`: `[n, W]`; `out`: `[H, W]`.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn gather(&self, shares: &[f32], ego: &[f32], others: &[f32], out: &mut [f32]) {
        let n_entities = 1 + others.len() / self.width;
        assert_eq!(shares.len(), self.n_heads * n_entities, "`shares` must be [H, 1 + n]");
        assert_eq!(ego.len(), self.width, "`ego` must be [W]");
        assert_eq!(out.len(), self.n_heads * self.width, "`out` must be [H, W]");
        let heads = shares.chunks_exact(n_entities).zip(out.chunks_exact_mut(self.width));
        for (shares, out) in heads {
            out.iter_mut().zip(ego).for_each(|(sum, value)| *sum = shares[0] * value);
            for (share, other) in shares[1..].iter().zip(others.chunks_exact(self.width)) {
                out.iter_mut().zip(other).for_each(|(sum, value)| *sum += share * value);
            }
        }
    }
}

/// Adds up products in a fixed order: in lanes, then over lanes, then what is left.
pub fn dot(a: &[f32], b: &[f32]) -> f32 {
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
    fn the_absent_get_no_share() {
        let attention = Attention { width: 2, n_heads: 2 };
        let (queries, ego, others) = ([1.0, 0.0, 0.0, 1.0], [1.0, 0.0], [0.0, 2.0]);
        let mut shares = [f32::NAN; 4];
        let share = |ego_there, others_there, shares: &mut [f32]| {
            let presence = FramePresence { n_others: 1, ego: ego_there, others: others_there };
            attention.shares(&queries, &ego, &others, presence, shares);
        };
        share(true, true, &mut shares);
        let e = 1.0_f32.exp();
        let expected = [e / (e + 1.0), 1.0 / (e + 1.0), 1.0 / (1.0 + e * e), e * e / (1.0 + e * e)];
        for (share, expected) in shares.iter().zip(expected) {
            assert!((share - expected).abs() < 1e-6, "{shares:?}");
        }
        let mut out = [f32::NAN; 4];
        attention.gather(&shares, &ego, &others, &mut out);
        assert_eq!(out, [shares[0], 2.0 * shares[1], shares[2], 2.0 * shares[3]]);
        // The ego is absent: all attention goes to the other.
        share(false, true, &mut shares);
        assert_eq!(shares, [0.0, 1.0, 0.0, 1.0]);
        // Everyone is absent: all count alike.
        share(false, false, &mut shares);
        assert_eq!(shares, [0.5; 4]);
    }

    #[test]
    fn ragged_widths_are_summed_whole() {
        let a: Vec<f32> = (0..11).map(|i| i as f32).collect();
        assert_eq!(dot(&a, &a), 385.0);
    }
}

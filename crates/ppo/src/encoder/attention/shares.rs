//! How much the egos take from whom: scores, softmax and weighted sum, forward and backward.
//!
//! The arithmetic is that of [`leadtime_policy::attention`]: forward the same bits as an actor's inference.

use std::iter::once;

use leadtime_policy::attention::{Attention, FramePresence, dot};

use crate::dense::resize;

/// What each of M egos takes from the present embeddings: of queries `[M, H W]`, egos `[M, W]` and others `[P, W]`,
/// `[M, H W]`.
#[derive(Clone, Copy, Debug)]
pub(super) struct EgoShares<'a> {
    pub(super) attention: Attention,
    /// The frames' presence, sample by sample. `[M]`
    pub(super) presence: &'a [FramePresence],
}

/// Slopes in queries `[M, H W]`, egos `[M, W]` and others `[P, W]`.
#[derive(Debug, Default)]
pub(super) struct AttentionSlopes {
    pub(super) queries: Vec<f32>,
    pub(super) egos: Vec<f32>,
    pub(super) others: Vec<f32>,
}

/// One ego: its queries `[H, W]`, its embedding `[W]`, those of the present others `[n, W]`.
struct EgoRow<'a> {
    queries: &'a [f32],
    ego: &'a [f32],
    others: &'a [f32],
    presence: FramePresence,
}

/// One head of one ego: its query `[W]`, its shares `[1 + n]`, the gradient of what it takes `[W]`.
struct HeadRow<'a> {
    query: &'a [f32],
    shares: &'a [f32],
    gradient: &'a [f32],
}

/// Where one head's gradients of one ego are added up: `[W]`, `[W]`, `[n, W]`.
struct Sums<'a> {
    query: &'a mut [f32],
    ego: &'a mut [f32],
    others: &'a mut [f32],
}

impl EgoShares<'_> {
    /// Computes what the egos take, `[M, H W]`.
    pub(super) fn forward(
        &self,
        queries: &[f32],
        egos: &[f32],
        others: &[f32],
        out: &mut Vec<f32>,
    ) {
        let Attention { width, n_heads } = self.attention;
        let wide = n_heads * width;
        let mut shares = Vec::new();
        let rows = self.rows(queries, egos, others);
        for (out, row) in resize(out, queries.len()).chunks_exact_mut(wide).zip(rows) {
            self.share(&row, &mut shares);
            self.attention.gather(&shares, row.ego, row.others, out);
        }
    }

    fn rows<'a>(
        &'a self,
        queries: &'a [f32],
        egos: &'a [f32],
        mut others: &'a [f32],
    ) -> impl Iterator<Item = EgoRow<'a>> {
        let Attention { width, n_heads } = self.attention;
        let rows = queries.chunks_exact(n_heads * width).zip(egos.chunks_exact(width));
        rows.zip(self.presence.iter()).map(move |((queries, ego), &presence)| {
            let (own, later) = others.split_at(presence.n_others * width);
            others = later;
            EgoRow { queries, ego, others: own, presence }
        })
    }

    /// Computes the shares `[H, 1 + n]` of one ego's attention.
    fn share(&self, row: &EgoRow<'_>, shares: &mut Vec<f32>) {
        shares.resize(self.attention.n_heads * row.presence.n_entities(), 0.0);
        self.attention.shares(row.queries, row.ego, row.others, row.presence, shares);
    }

    /// Computes the slopes from those in what is taken, `[M, H W]`.
    pub(super) fn backward(
        &self,
        queries: &[f32],
        egos: &[f32],
        others: &[f32],
        g: &[f32],
        found: &mut AttentionSlopes,
    ) {
        let Attention { width, n_heads } = self.attention;
        for (slopes, like) in
            [(&mut found.queries, queries), (&mut found.egos, egos), (&mut found.others, others)]
        {
            resize(slopes, like.len()).fill(0.0);
        }
        let (mut shares, mut d_scores) = (Vec::new(), Vec::new());
        let mut d_others = found.others.as_mut_slice();
        for (m, row) in self.rows(queries, egos, others).enumerate() {
            self.share(&row, &mut shares);
            let (d_own, d_later) = d_others.split_at_mut(row.others.len());
            d_others = d_later;
            let d_ego = &mut found.egos[m * width..][..width];
            for (head, shares) in shares.chunks_exact(row.presence.n_entities()).enumerate() {
                let at = (m * n_heads + head) * width;
                let query = &row.queries[head * width..][..width];
                let head = HeadRow { query, shares, gradient: &g[at..][..width] };
                let d_query = &mut found.queries[at..][..width];
                let sums = Sums { query: d_query, ego: d_ego, others: d_own };
                self.backward_head(&row, &head, sums, &mut d_scores);
            }
        }
    }

    /// Adds one head's gradients to the sums: with g that of the output, `ds_i = p_i (g·e_i - Σ_j p_j g·e_j)`, and
    /// nothing through the score of an absent entity.
    fn backward_head(
        &self,
        row: &EgoRow<'_>,
        head: &HeadRow<'_>,
        sums: Sums<'_>,
        d_scores: &mut Vec<f32>,
    ) {
        let &HeadRow { query, shares, gradient: g } = head;
        let width = self.attention.width;
        let entities = || once(row.ego).chain(row.others.chunks_exact(width));
        d_scores.clear();
        d_scores.extend(entities().map(|entity| dot(g, entity)));
        let mean: f32 = shares.iter().zip(&*d_scores).map(|(share, d)| share * d).sum();
        let d_entities = once(sums.ego).chain(sums.others.chunks_exact_mut(width));
        for (i, (entity, d_entity)) in entities().zip(d_entities).enumerate() {
            add_scaled(d_entity, g, shares[i]);
            if row.presence.has(i) {
                let d_score = shares[i] * (d_scores[i] - mean) * self.attention.scale();
                add_scaled(sums.query, entity, d_score);
                add_scaled(d_entity, query, d_score);
            }
        }
    }
}

fn add_scaled(sums: &mut [f32], values: &[f32], factor: f32) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += factor * value);
}

#[cfg(test)]
mod tests {
    use candle_core::{Device, Tensor, Var};

    use super::*;
    use crate::test_support::{Plain, close, flat};

    const ATTENTION: Attention = Attention { width: 4, n_heads: 2 };
    const M: usize = 5;
    const N: usize = 4;

    /// Draws a variable from -2 to 2.
    fn draw(shape: (usize, usize), seed: u64) -> Var {
        Var::from_tensor(&(crate::test_support::draw(shape, seed).as_tensor() * 2.0).unwrap())
            .unwrap()
    }

    /// Attention to all of N entities per ego, of the engine's own operations; `presence`: `[M, N]`.
    fn plain(queries: &Tensor, egos: &Tensor, others: &Tensor, presence: &[f32]) -> Tensor {
        let others = others.reshape((M, N - 1, 4)).unwrap();
        let all = Tensor::cat(&[&egos.unsqueeze(1).unwrap(), &others], 1).unwrap();
        let queries = queries.reshape((M, 2, 4)).unwrap();
        let scores = queries.matmul(&all.transpose(1, 2).unwrap().contiguous().unwrap()).unwrap();
        let scores = (scores / 2_f64.sqrt()).unwrap();
        let hidden = presence.iter().map(|p| if *p < 0.5 { -1e9_f32 } else { 0.0 });
        let hidden = Tensor::from_vec(hidden.collect(), (M, 1, N), &Device::Cpu).unwrap();
        let scores = scores.broadcast_add(&hidden).unwrap();
        let shares = candle_nn::ops::softmax(&scores, 2).unwrap();
        shares.matmul(&all.contiguous().unwrap()).unwrap().reshape((M, 8)).unwrap()
    }

    /// The values and slopes of egos that take from others.
    fn taken(
        [queries, egos, others]: [&Var; 3],
        presence: &[FramePresence],
        g: &[f32],
    ) -> (Vec<f32>, AttentionSlopes) {
        let shares = EgoShares { attention: ATTENTION, presence };
        let [queries, egos, others] = [queries, egos, others].map(|var| flat(var));
        let (mut out, mut slopes) = (Vec::new(), AttentionSlopes::default());
        shares.forward(&queries, &egos, &others, &mut out);
        shares.backward(&queries, &egos, &others, g, &mut slopes);
        (out, slopes)
    }

    #[test]
    fn shares_have_the_values_and_gradients_of_plain_attention() {
        let (queries, egos, others) = (draw((M, 8), 1), draw((M, 4), 2), draw((M * (N - 1), 4), 3));
        // The last frame's ego is absent, and so are some others.
        let presence: Vec<f32> =
            (0..M * N).map(|i| f32::from(u8::from(i % 3 != 2 && i != (M - 1) * N))).collect();
        let is_present = |i: &usize| presence[i / (N - 1) * N + 1 + i % (N - 1)] > 0.5;
        let kept: Vec<usize> = (0..M * (N - 1)).filter(is_present).collect();
        let frames = presence.chunks_exact(N).map(|frame| FramePresence {
            n_others: frame[1..].iter().filter(|p| **p > 0.5).count(),
            ego: frame[0] > 0.5,
            others: true,
        });
        let frames: Vec<FramePresence> = frames.collect();
        let plain = plain(&queries, &egos, &others, &presence);
        let plain = Plain::of(&plain, &[&queries, &egos, &others]);
        let rows: Vec<u32> = kept.iter().map(|&i| i as u32).collect();
        let rows = Tensor::from_vec(rows, kept.len(), &Device::Cpu).unwrap();
        let present = Var::from_tensor(&others.index_select(&rows, 0).unwrap()).unwrap();
        let (out, slopes) = taken([&queries, &egos, &present], &frames, &plain.target);
        close(&out, &plain.values, 1e-5);
        close(&slopes.queries, &plain.gradients[0], 1e-5);
        close(&slopes.egos, &plain.gradients[1], 1e-5);
        let of_present = kept.iter().flat_map(|i| plain.gradients[2][i * 4..(i + 1) * 4].to_vec());
        close(&slopes.others, &of_present.collect::<Vec<_>>(), 1e-5);
    }

    #[test]
    fn an_ego_alone_attends_to_itself() {
        let (queries, egos, others) = (draw((1, 8), 1), draw((1, 4), 2), draw((0, 4), 3));
        let alone = FramePresence { n_others: 0, ego: true, others: true };
        let (out, slopes) = taken([&queries, &egos, &others], &[alone], &[1.0; 8]);
        let ego = flat(&egos);
        close(&out, &[ego.clone(), ego].concat(), 1e-6);
        close(&slopes.egos, &[2.0; 4], 1e-6);
    }
}

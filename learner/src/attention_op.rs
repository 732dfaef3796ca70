//! Ego attention as one node of the engine's graph: scores, softmax and weighted sum fused, forward and backward.
//!
//! The arithmetic is that of [`leadtime_policy::attention`]: forward the same bits as an actor's inference.

use std::sync::Arc;

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor};
use leadtime_policy::attention::Attention;

use crate::storage::{floats, with_floats};

/// What each of M egos takes from its N entities: of query `[M, D]`, keys `[M N, D]` and values `[M N, D]`, `[M, D]`.
#[derive(Clone, Debug)]
pub(crate) struct AttentionOp {
    pub(crate) attention: Attention,
    /// `[M, N]`
    pub(crate) presence: Arc<Vec<f32>>,
}

impl CustomOp3 for AttentionOp {
    fn name(&self) -> &'static str {
        "ego-attention"
    }

    fn cpu_fwd(
        &self,
        query: &CpuStorage,
        query_layout: &Layout,
        keys: &CpuStorage,
        keys_layout: &Layout,
        values: &CpuStorage,
        values_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let Attention { n_entities, width, n_heads } = self.attention;
        let (m, query_width) = query_layout.shape().dims2()?;
        let expected = (m * n_entities, width);
        let fits = query_width == width
            && keys_layout.shape().dims2()? == expected
            && values_layout.shape().dims2()? == expected
            && self.presence.len() == m * n_entities;
        if !fits {
            candle_core::bail!("ego attention of {m} egos to {n_entities} entities: wrong shapes")
        }
        let (query, keys) = (floats(query, query_layout)?, floats(keys, keys_layout)?);
        let values = floats(values, values_layout)?;
        let (mut out, mut shares) = (vec![0.0; m * width], vec![0.0; n_heads * n_entities]);
        let rows = self.rows(query, keys, values);
        for (out, (query, keys, values, presence)) in out.chunks_exact_mut(width).zip(rows) {
            self.attention.shares(query, keys, presence, &mut shares);
            self.attention.gather(&shares, values, out);
        }
        Ok((CpuStorage::F32(out), Shape::from((m, width))))
    }

    fn bwd(
        &self,
        query: &Tensor,
        keys: &Tensor,
        values: &Tensor,
        _out: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let gradients = with_floats(query, |query| {
            with_floats(keys, |keys| {
                with_floats(values, |values| {
                    with_floats(gradient, |gradient| self.backward(query, keys, values, gradient))
                })
            })
        })????;
        let tensor = |numbers: Vec<f32>, like: &Tensor| {
            Tensor::from_vec(numbers, like.shape(), like.device()).map(Some)
        };
        let Gradients { query: d_query, keys: d_keys, values: d_values } = gradients;
        Ok((tensor(d_query, query)?, tensor(d_keys, keys)?, tensor(d_values, values)?))
    }
}

struct Gradients {
    query: Vec<f32>,
    keys: Vec<f32>,
    values: Vec<f32>,
}

type Row<'a> = (&'a [f32], &'a [f32], &'a [f32], &'a [f32]);

impl AttentionOp {
    /// Lists each ego's query, keys, values and presence.
    fn rows<'a>(
        &'a self,
        query: &'a [f32],
        keys: &'a [f32],
        values: &'a [f32],
    ) -> impl Iterator<Item = Row<'a>> {
        let Attention { n_entities, width, .. } = self.attention;
        let all = n_entities * width;
        let entities = keys.chunks_exact(all).zip(values.chunks_exact(all));
        let rows = query.chunks_exact(width).zip(entities);
        rows.zip(self.presence.chunks_exact(n_entities))
            .map(|((query, (keys, values)), presence)| (query, keys, values, presence))
    }

    /// Computes all gradients: with g that of the output, `ds_i = p_i (g·v_i - Σ_j p_j g·v_j)`, and nothing through
    /// the score of an entity that is not there.
    fn backward(&self, query: &[f32], keys: &[f32], values: &[f32], gradient: &[f32]) -> Gradients {
        let Attention { n_entities, width, n_heads } = self.attention;
        let (d, scale) = (self.attention.head_width(), self.attention.scale());
        let mut found = Gradients {
            query: vec![0.0; query.len()],
            keys: vec![0.0; keys.len()],
            values: vec![0.0; values.len()],
        };
        let mut shares = vec![0.0; n_heads * n_entities];
        let mut d_scores = vec![0.0; n_entities];
        let all = n_entities * width;
        for (m, (query, keys, values, presence)) in self.rows(query, keys, values).enumerate() {
            self.attention.shares(query, keys, presence, &mut shares);
            let gradient = &gradient[m * width..][..width];
            let d_query = &mut found.query[m * width..][..width];
            let d_keys = &mut found.keys[m * all..][..all];
            let d_values = &mut found.values[m * all..][..all];
            for (head, shares) in shares.chunks_exact(n_entities).enumerate() {
                let own = head * d..(head + 1) * d;
                let of = |i: usize| i * width + own.start..i * width + own.end;
                let (query, gradient) = (&query[own.clone()], &gradient[own.clone()]);
                for (i, d_score) in d_scores.iter_mut().enumerate() {
                    *d_score = gradient.iter().zip(&values[of(i)]).map(|(g, v)| g * v).sum();
                }
                let mean: f32 = shares.iter().zip(&d_scores).map(|(share, d)| share * d).sum();
                for (i, &share) in shares.iter().enumerate() {
                    add_scaled(&mut d_values[of(i)], gradient, share);
                    let counts = f32::from(u8::from(Attention::is_present(presence[i])));
                    let d_score = counts * share * (d_scores[i] - mean) * scale;
                    add_scaled(&mut d_query[own.clone()], &keys[of(i)], d_score);
                    add_scaled(&mut d_keys[of(i)], query, d_score);
                }
            }
        }
        found
    }
}

fn add_scaled(sums: &mut [f32], values: &[f32], factor: f32) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += factor * value);
}

#[cfg(test)]
mod tests {
    use candle_core::{Device, Var};
    use leadtime_numerics::Pcg64;

    use super::*;
    use crate::test_support::close;

    const ATTENTION: Attention = Attention { n_entities: 4, width: 6, n_heads: 2 };
    const M: usize = 5;

    fn draw(shape: (usize, usize), seed: u64) -> Var {
        let mut generator = Pcg64::seed_from_u64(seed);
        let draws = (0..shape.0 * shape.1).map(|_| generator.uniform(-2.0, 2.0) as f32);
        Var::from_tensor(&Tensor::from_vec(draws.collect(), shape, &Device::Cpu).unwrap()).unwrap()
    }

    /// Attention of the engine's own operations.
    fn plain(query: &Tensor, keys: &Tensor, values: &Tensor, presence: &[f32]) -> Tensor {
        let split = |x: &Tensor, n: usize| {
            x.reshape((M, n, 2, 3)).unwrap().transpose(1, 2).unwrap().contiguous().unwrap()
        };
        let (query, keys, values) = (split(query, 1), split(keys, 4), split(values, 4));
        let scores = query.matmul(&keys.transpose(2, 3).unwrap().contiguous().unwrap()).unwrap();
        let scores = (scores / 3_f64.sqrt()).unwrap();
        let hidden = presence.iter().map(|p| if *p < 0.5 { -1e9_f32 } else { 0.0 });
        let hidden = Tensor::from_vec(hidden.collect(), (M, 1, 1, 4), &Device::Cpu).unwrap();
        let scores = scores.broadcast_add(&hidden).unwrap();
        let shares = candle_nn::ops::softmax(&scores, 3).unwrap();
        shares.matmul(&values).unwrap().transpose(1, 2).unwrap().reshape((M, 6)).unwrap()
    }

    #[test]
    fn the_fused_attention_has_the_values_and_gradients_of_the_plain_one() {
        let (query, keys, values) = (draw((M, 6), 1), draw((M * 4, 6), 2), draw((M * 4, 6), 3));
        let target = draw((M, 6), 4);
        let presence: Vec<f32> = (0..M * 4).map(|i| f32::from(u8::from(i % 3 != 2))).collect();
        let op = AttentionOp { attention: ATTENTION, presence: Arc::new(presence.clone()) };
        let fused = query.apply_op3(&keys, &values, op).unwrap();
        let plain = plain(&query, &keys, &values, &presence);
        close(&fused, &plain, 1e-5);
        let gradients =
            |y: &Tensor| (y * target.as_tensor()).unwrap().sum_all().unwrap().backward();
        let (of_fused, of_plain) = (gradients(&fused).unwrap(), gradients(&plain).unwrap());
        for var in [&query, &keys, &values] {
            close(of_fused.get(var).unwrap(), of_plain.get(var).unwrap(), 1e-5);
        }
    }

    #[test]
    fn wrong_shapes_are_refused() {
        let (query, keys) = (draw((M, 6), 1), draw((M * 3, 6), 2));
        let op = AttentionOp { attention: ATTENTION, presence: Arc::new(vec![1.0; M * 4]) };
        assert!(query.apply_op3(&keys, &keys, op).is_err());
    }
}

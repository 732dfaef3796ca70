//! The optimiser: Adam with a clipped global gradient norm.
//!
//! The engine's own optimiser decays weights by default and keeps its moments private, so a checkpoint could not hold
//! them. Here the state is public, and a step is one fused pass per tensor, in the order of names.
//!
//! # Source
//!
//! Kingma, Ba, *Adam*, ICLR 2015, as `torch.optim.Adam` computes it: ε is added after the bias-corrected root.

use std::cell::RefCell;
use std::collections::BTreeMap;

use candle_core::{CpuStorage, InplaceOp1, Layout, Var};

use crate::dense::Gradients;

const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f64 = 1e-5;

/// First and second moment of one tensor's gradient.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Moments {
    /// Running mean of the gradient.
    pub(crate) first: Vec<f32>,
    /// Running mean of its square.
    pub(crate) second: Vec<f32>,
}

/// The optimiser: its state, and the step that changes it.
#[derive(Clone, Debug)]
pub(crate) struct Adam {
    /// Moments by tensor name.
    pub(crate) moments: BTreeMap<String, Moments>,
    /// β₁ and β₂ to the power of the steps taken.
    pub(crate) powers: [f64; 2],
}

impl Adam {
    /// Starts with zero moments.
    pub(crate) fn new(vars: &BTreeMap<String, Var>) -> Self {
        let zero = |var: &Var| {
            let n = var.elem_count();
            Moments { first: vec![0.0; n], second: vec![0.0; n] }
        };
        let moments = vars.iter().map(|(name, var)| (name.clone(), zero(var))).collect();
        Self { moments, powers: [1.0; 2] }
    }

    /// Takes one step along gradients, each multiplied by `scale` first.
    ///
    /// A gradient has the shape of its parameter. Every parameter must have its moments.
    pub(crate) fn step(
        &mut self,
        vars: &BTreeMap<String, Var>,
        gradients: &Gradients,
        learning_rate: f64,
        scale: f64,
    ) -> candle_core::Result<()> {
        self.powers[0] *= BETA1;
        self.powers[1] *= BETA2;
        let scale = scale as f32;
        let step = (learning_rate / (1.0 - self.powers[0])) as f32;
        let root = (1.0 / (1.0 - self.powers[1]).sqrt()) as f32;
        for (name, gradient) in gradients {
            let moments = self.moments.get_mut(name).expect("every parameter has its moments");
            let moments = RefCell::new(moments);
            vars[name].inplace_op1(&AdamStep { gradient, scale, step, root, moments })?;
        }
        Ok(())
    }
}

/// One tensor's step, and the factors of gradient, step and root.
struct AdamStep<'a> {
    gradient: &'a [f32],
    scale: f32,
    step: f32,
    root: f32,
    moments: RefCell<&'a mut Moments>,
}

impl InplaceOp1 for AdamStep<'_> {
    fn name(&self) -> &'static str {
        "adam-step"
    }

    fn cpu_fwd(&self, parameter: &mut CpuStorage, layout: &Layout) -> candle_core::Result<()> {
        let (CpuStorage::F32(parameter), Some((start, end))) =
            (parameter, layout.contiguous_offsets())
        else {
            candle_core::bail!("{}: parameters must be contiguous 32-bit numbers", self.name())
        };
        let mut moments = self.moments.borrow_mut();
        self.update(&mut parameter[start..end], &mut moments);
        Ok(())
    }
}

impl AdamStep<'_> {
    fn update(&self, parameter: &mut [f32], moments: &mut Moments) {
        let &Self { gradient, scale, step, root, .. } = self;
        let (keep1, keep2) = (BETA1 as f32, BETA2 as f32);
        let (take1, take2) = ((1.0 - BETA1) as f32, (1.0 - BETA2) as f32);
        let epsilon = EPSILON as f32;
        let Moments { first, second } = moments;
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                let moments = first.iter_mut().zip(second.iter_mut());
                for ((p, &g), (m, v)) in parameter.iter_mut().zip(gradient).zip(moments) {
                    let g = g * scale;
                    *m = *m * keep1 + g * take1;
                    *v = *v * keep2 + g * g * take2;
                    *p -= step * *m / (v.sqrt() * root + epsilon);
                }
            },
        );
    }
}

/// Computes the L2 norm over all gradients, in the order of names.
///
/// Squares are summed in eight interleaved 64-bit chains per tensor: one order, whatever the machine.
pub(crate) fn global_norm(gradients: &Gradients) -> f64 {
    let mut total = 0.0;
    for values in gradients.values() {
        let (chunks, rest) = values.as_chunks::<8>();
        let mut sums = [0.0_f64; 8];
        for chunk in chunks {
            for (sum, &x) in sums.iter_mut().zip(chunk) {
                *sum += f64::from(x) * f64::from(x);
            }
        }
        let rest: f64 = rest.iter().map(|&x| f64::from(x) * f64::from(x)).sum();
        total += sums.iter().sum::<f64>() + rest;
    }
    total.sqrt()
}

/// Returns the factor that shortens a gradient of this norm to at most `longest`.
///
/// # Source
///
/// `torch.nn.utils.clip_grad_norm_`.
pub(crate) fn clip_factor(norm: f64, longest: f64) -> f64 {
    (longest / (norm + 1e-6)).min(1.0)
}

#[cfg(test)]
#[expect(clippy::unreadable_literal, reason = "golden numbers are as the script writes them")]
mod tests {
    use candle_core::{Device, Tensor};

    use super::*;
    include!("../golden/adam.rs");

    #[test]
    fn five_clipped_steps_equal_pytorchs() {
        // crates/ppo/golden/golden.py, `adam`: torch.optim.Adam and clip_grad_norm_, one tiny and four long gradients.
        let tensor = |values: &[f32]| Tensor::new(values, &Device::Cpu).unwrap();
        let vars = BTreeMap::from([
            ("a".to_owned(), Var::from_tensor(&tensor(&WEIGHT)).unwrap()),
            ("b".to_owned(), Var::from_tensor(&tensor(&BIAS)).unwrap()),
        ]);
        let mut adam = Adam::new(&vars);
        for (step, values) in GRADIENTS.chunks_exact(9).enumerate() {
            let gradients = BTreeMap::from([
                ("a".to_owned(), values[..6].to_vec()),
                ("b".to_owned(), values[6..].to_vec()),
            ]);
            let scale = clip_factor(global_norm(&gradients), 0.5);
            let learning_rate = 1e-2 * (1.0 - step as f64 / 5.0);
            adam.step(&vars, &gradients, learning_rate, scale).unwrap();
        }
        let expected = WEIGHT_AFTER.iter().chain(&BIAS_AFTER);
        let found: Vec<f32> = vars.values().flat_map(|var| var.to_vec1::<f32>().unwrap()).collect();
        for (i, (a, b)) in found.iter().zip(expected).enumerate() {
            assert!((a - b).abs() < 1e-6, "{i}: {a} {b}");
        }
    }

    #[test]
    fn the_norm_counts_every_element_once() {
        let gradients =
            BTreeMap::from([("a".to_owned(), vec![1.0; 19]), ("b".to_owned(), vec![1.0; 6])]);
        assert_eq!(global_norm(&gradients), 5.0);
        assert_eq!(clip_factor(0.4, 0.5), 1.0);
        assert!((clip_factor(2.0, 0.5) - 0.25).abs() < 1e-6);
    }
}

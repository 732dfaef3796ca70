//! Actor and critic behind the encoder, with the loss on top: forward and backward.
//!
//! ```text
//! rows of a minibatch     block 0          │ block 1          │ …       each block and branch by itself, one thread each
//! of one block            chunk, chunk, …                               features ─► layers ─► loss ─► slopes ─► sums
//! gradients               sums of block 0 + sums of block 1 + …
//! ```
//!
//! What a row gives depends on that row alone, and an element of a gradient is one chain of additions over the rows of
//! a block, and then over the blocks. So neither the size of chunks nor the number of threads changes a bit, and
//! forward the bits are those of an actor's inference. Nothing is copied between layers: a layer's output by panels is
//! the next one's input and the operand of its gradient.

use std::collections::BTreeMap;

use candle_core::{Result, Var};
use leadtime_numerics::Panels;
use leadtime_numerics::kernel::{Activation, PANEL};
use leadtime_policy::architecture::{Branch, layers};
use leadtime_proto::{Encoder, PolicySpec};

use crate::dense::{Gradients, LayerGradient, PackedLayer};
use crate::loss::{LossReport, PolicyTerms, PpoLoss};
use crate::team::Team;

/// Rows whose gradients are one chain of additions. Part of the definition of an update: another number is other bits.
pub(crate) const BLOCK: usize = 512;
/// Rows that go through all layers together: what they leave behind stays in the second-level cache.
const CHUNK: usize = 128;

/// The layers of one branch, input first, and their gradients.
#[derive(Debug)]
struct Stack {
    branch: Branch,
    layers: Vec<PackedLayer>,
    /// Sums over the blocks of a minibatch.
    gradients: Vec<LayerGradient>,
    /// Whether a block of the minibatch is in them.
    has_gradients: bool,
}

impl Stack {
    fn new(spec: &PolicySpec, branch: Branch) -> Self {
        let layers: Vec<_> = layers(spec, branch).into_iter().map(PackedLayer::new).collect();
        let gradients = vec![LayerGradient::default(); layers.len()];
        Self { branch, layers, gradients, has_gradients: false }
    }

    /// Begins a minibatch with the variables' present numbers.
    fn begin(&mut self, vars: &BTreeMap<String, Var>) -> Result<()> {
        self.has_gradients = false;
        self.layers.iter_mut().try_for_each(|layer| layer.pack(vars))
    }

    /// Adds one block's gradients to the sum over the blocks before it; the first block's start the sum.
    fn add(&mut self, block: &mut [LayerGradient]) {
        for (sum, gradient) in self.gradients.iter_mut().zip(block) {
            if self.has_gradients {
                sum.add(gradient);
            } else {
                std::mem::swap(sum, gradient);
            }
        }
        self.has_gradients = true;
    }
}

/// Where the rows of a minibatch come from.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Features<'a> {
    /// Of all samples, `[N, F]`: a row's are those of its sample.
    OfSamples(&'a [f32]),
    /// Of these rows, `[M, F]`, from an encoder that learns.
    OfRows(&'a [f32]),
}

/// The pass of one block through one branch.
#[derive(Debug, Default)]
struct BranchPass {
    /// The features that enter the branch. `[rows, F]`
    input: Panels,
    /// Each layer's outputs. `[rows, n_out]`
    outputs: Vec<Panels>,
    /// The loss's slopes in what each layer computes before its activation. `[rows, n_out]`
    slopes: Vec<Panels>,
    /// The loss's slopes in the input. `[rows, F]`
    d_input: Panels,
    /// Sums over the rows of the block.
    gradients: Vec<LayerGradient>,
    /// The slopes in the features of the whole block. `[rows of the block, F]`, or empty
    d_features: Vec<f32>,
    /// What the rows of the block contribute: the actor's, or the critic's.
    policy_terms: Vec<PolicyTerms>,
    value_losses: Vec<f32>,
}

/// One block's rows in one branch.
struct BranchTask<'a> {
    pass: &'a mut BranchPass,
    stack: &'a Stack,
    /// The first row among those of the run.
    first: usize,
    samples: &'a [usize],
}

impl BranchTask<'_> {
    fn run(&mut self, loss: &PpoLoss<'_>, features: Features<'_>, learns: bool) {
        let Self { pass, stack, samples, .. } = self;
        pass.begin(stack);
        let mut first = self.first;
        for samples in samples.chunks(CHUNK) {
            pass.load(stack, features, first, samples);
            pass.forward(stack);
            pass.loss(stack.branch, loss, samples);
            pass.backward(stack, learns);
            first += samples.len();
        }
    }
}

impl BranchPass {
    fn begin(&mut self, stack: &Stack) {
        let n_layers = stack.layers.len();
        self.outputs.resize_with(n_layers, Panels::default);
        self.slopes.resize_with(n_layers, Panels::default);
        self.gradients.resize_with(n_layers, LayerGradient::default);
        for (gradient, packed) in self.gradients.iter_mut().zip(&stack.layers) {
            gradient.clear(&packed.layer);
        }
        self.d_features.clear();
        self.policy_terms.clear();
        self.value_losses.clear();
    }

    fn load(&mut self, stack: &Stack, features: Features<'_>, first: usize, samples: &[usize]) {
        let n_features = stack.layers.first().map_or(0, |packed| packed.layer.n_in);
        self.input.resize(samples.len(), n_features);
        for (row, &sample) in samples.iter().enumerate() {
            let (features, place) = match features {
                Features::OfSamples(features) => (features, sample),
                Features::OfRows(features) => (features, first + row),
            };
            self.input.set_row(row, &features[place * n_features..][..n_features]);
        }
    }

    fn forward(&mut self, stack: &Stack) {
        for (i, PackedLayer { layer, matrix, bias }) in stack.layers.iter().enumerate() {
            let (before, after) = self.outputs.split_at_mut(i);
            let input = before.last().unwrap_or(&self.input);
            matrix.forward.multiply_panels(input, bias, layer.activation, &mut after[0]);
        }
    }

    /// Computes what the rows contribute, and the slopes of the last layer.
    fn loss(&mut self, branch: Branch, loss: &PpoLoss<'_>, samples: &[usize]) {
        let (Some(outputs), Some(slopes)) = (self.outputs.last(), self.slopes.last_mut()) else {
            return; // Every branch ends with its head.
        };
        match branch {
            Branch::Actor => loss.policy_rows(samples, outputs, slopes, &mut self.policy_terms),
            Branch::Critic => loss.value_rows(samples, outputs, slopes, &mut self.value_losses),
        }
    }

    /// Computes the slopes of the layers below the last one, and adds the gradients of all.
    fn backward(&mut self, stack: &Stack, wants_input: bool) {
        for (i, packed) in stack.layers.iter().enumerate().rev() {
            let (before, after) = self.slopes.split_at_mut(i);
            let slopes = &after[0];
            let input = if i == 0 { &self.input } else { &self.outputs[i - 1] };
            let LayerGradient { weights, biases } = &mut self.gradients[i];
            for (panel, weights) in weights.chunks_mut(PANEL * packed.layer.n_in).enumerate() {
                input.add_outer_products(slopes, panel, weights);
            }
            slopes.add_rows(biases);
            if let Some(below) = before.last_mut() {
                packed.matrix.backward.multiply_panels(slopes, &[], Activation::Linear, below);
                let outputs = input.data().as_flattened();
                let activation = stack.layers[i - 1].layer.activation;
                activation.backward(outputs, below.data_mut().as_flattened_mut());
            } else if wants_input {
                packed.matrix.backward.multiply_panels(
                    slopes,
                    &[],
                    Activation::Linear,
                    &mut self.d_input,
                );
                for row in 0..self.d_input.depth() {
                    let start = self.d_features.len();
                    self.d_features.resize(start + packed.layer.n_in, 0.0);
                    self.d_input.copy_row(row, &mut self.d_features[start..]);
                }
            }
        }
    }
}

/// Actor and critic, and the memory of their passes.
#[derive(Debug)]
pub(crate) struct Stacks {
    actor: Stack,
    critic: Stack,
    /// Whether the encoder learns, so that it wants the slopes in the features.
    encoder_learns: bool,
    /// Rows of a block: of a recurrent network all of a minibatch, as of its encoder.
    block: usize,
    /// The actor's passes by block, then the critic's.
    passes: Vec<BranchPass>,
    /// What the rows of the last run contributed. `[M]`
    policy_terms: Vec<PolicyTerms>,
    /// The slopes of the last run's loss in its features. `[M, F]`, or empty
    d_features: Vec<f32>,
}

impl Stacks {
    pub(crate) fn new(spec: &PolicySpec) -> Self {
        Self {
            actor: Stack::new(spec, Branch::Actor),
            critic: Stack::new(spec, Branch::Critic),
            encoder_learns: !matches!(spec.encoder, Encoder::Identity),
            block: if spec.recurrent_dim() > 0 { usize::MAX } else { BLOCK },
            passes: Vec::new(),
            policy_terms: Vec::new(),
            d_features: Vec::new(),
        }
    }

    /// Begins a minibatch with the variables' present numbers.
    pub(crate) fn begin(&mut self, vars: &BTreeMap<String, Var>) -> Result<()> {
        self.actor.begin(vars)?;
        self.critic.begin(vars)
    }

    /// Runs the rows of these samples, adds their gradients up, and returns their share in the loss.
    pub(crate) fn run(
        &mut self,
        loss: &PpoLoss<'_>,
        features: Features<'_>,
        samples: &[usize],
        team: &Team,
    ) -> LossReport {
        let block_len = self.block;
        let n_blocks = samples.len().div_ceil(block_len);
        let n_passes = self.passes.len().max(2 * n_blocks);
        self.passes.resize_with(n_passes, BranchPass::default);
        let learns = self.encoder_learns;
        let (actors, critics) = self.passes[..2 * n_blocks].split_at_mut(n_blocks);
        let branches = [(&self.actor, &mut *actors), (&self.critic, &mut *critics)];
        // The larger tasks first, so that no thread ends up alone with one of them.
        let mut tasks = Vec::with_capacity(2 * n_blocks);
        for (stack, passes) in branches {
            for (b, (samples, pass)) in samples.chunks(block_len).zip(passes).enumerate() {
                let first = b.saturating_mul(block_len);
                tasks.push(BranchTask { pass, stack, first, samples });
            }
        }
        team.for_each(tasks.into_iter(), |mut task| task.run(loss, features, learns));
        self.policy_terms.clear();
        self.d_features.clear();
        let mut report = LossReport::default();
        for (from_actor, from_critic) in actors.iter().zip(&*critics) {
            report.add(&loss.report(&from_actor.policy_terms, &from_critic.value_losses));
            self.policy_terms.extend_from_slice(&from_actor.policy_terms);
            let slopes = from_actor.d_features.iter().zip(&from_critic.d_features);
            self.d_features.extend(slopes.map(|(a, b)| a + b));
        }
        for (stack, passes) in [(&mut self.actor, actors), (&mut self.critic, critics)] {
            for pass in passes {
                stack.add(&mut pass.gradients);
            }
        }
        report
    }

    /// Returns the slopes of the last run's loss in its features. `[M, F]`, or empty if no encoder learns
    pub(crate) fn d_features(&self) -> &[f32] {
        &self.d_features
    }

    /// Returns what the last run's rows contributed to the policy's loss. `[M]`
    pub(crate) fn policy_terms(&self) -> &[PolicyTerms] {
        &self.policy_terms
    }

    /// Returns the gradients of the minibatch by tensor name.
    pub(crate) fn gradients(&self) -> Gradients {
        let mut all = Gradients::new();
        for stack in [&self.actor, &self.critic] {
            for (PackedLayer { layer, .. }, gradient) in stack.layers.iter().zip(&stack.gradients) {
                all.insert(layer.weight(), gradient.weights.clone());
                all.insert(layer.bias(), gradient.biases.clone());
            }
        }
        all
    }
}

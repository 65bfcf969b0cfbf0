//! Fully connected layers as tensors of a model.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use shaders::networks::linear::{Activation, Layer, linear, linears};
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::data::Streams;
use crate::model::{ModelState, Variables};

/// The distribution of the initial weights and biases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum FirstWeights {
    /// Uniform in ±√(6 / (inputs + outputs)) (Glorot and Bengio 2010); biases in ±1/√inputs.
    Xavier,
    /// Weights and biases uniform in ±1/√inputs, the default of PyTorch.
    FanIn,
    /// Uniform in ±√(6 / inputs) (He et al. 2015); no biases.
    He,
    /// Normal with this standard deviation; no biases.
    Normal(f64),
    /// Zero weights and biases: the layer's output is zero at the start.
    Zero,
}

/// Adds `{name}.weight` [outputs, inputs] and `{name}.bias` [outputs].
pub(crate) fn insert_layer<T: Real>(
    state: &mut ModelState<T>,
    name: &str,
    inputs: usize,
    outputs: usize,
    first: FirstWeights,
    random: Streams,
) {
    let fan_in = (1.0 / inputs as f64).sqrt();
    let (weight_name, bias_name) = (format!("{name}.weight"), format!("{name}.bias"));
    let mut weights = random.tensor(&weight_name);
    let mut within = |bound: f64| uniform(&[outputs, inputs], -bound, bound, &mut weights);
    let weight = match first {
        FirstWeights::Xavier => within((6.0 / (inputs + outputs) as f64).sqrt()),
        FirstWeights::FanIn => within(fan_in),
        FirstWeights::He => within((6.0 / inputs as f64).sqrt()),
        FirstWeights::Normal(deviation) => normal(&[outputs, inputs], deviation, &mut weights),
        FirstWeights::Zero => within(0.0),
    };
    let bias_bound = match first {
        FirstWeights::Xavier | FirstWeights::FanIn => fan_in,
        FirstWeights::He | FirstWeights::Normal(_) | FirstWeights::Zero => 0.0,
    };
    let bias = uniform(&[outputs], -bias_bound, bias_bound, &mut random.tensor(&bias_name));
    state.insert(weight_name, weight);
    state.insert(bias_name, bias);
}

/// f(x·Wᵀ + b) with the tensors of [`insert_layer`].
pub(crate) fn apply_layer<T: Real>(
    tape: &mut Tape<T>,
    model: &Variables,
    name: &str,
    x: Var,
    activation: Activation,
) -> Var {
    let (weight, bias) = (model.get(&format!("{name}.weight")), model.get(&format!("{name}.bias")));
    linear(tape, x, weight, bias, activation)
}

/// Applies several layers ([`apply_layer`]) at once, each given by its name and its x.
pub(crate) fn apply_layers<T: Real>(
    tape: &mut Tape<T>,
    model: &Variables,
    layers: &[(String, Var)],
    activation: Activation,
) -> Vec<Var> {
    let tensor = |name: &str, which: &str| model.get(&format!("{name}.{which}"));
    let layer = |(name, x): &(String, Var)| Layer { x: *x, weight: tensor(name, "weight"), bias: tensor(name, "bias") };
    linears(tape, &layers.iter().map(layer).collect::<Vec<_>>(), activation)
}

/// Adds `{name}.weight` [outputs, inputs] of a layer without bias.
pub(crate) fn insert_matrix<T: Real>(
    state: &mut ModelState<T>,
    name: &str,
    inputs: usize,
    outputs: usize,
    random: Streams,
) {
    let bound = (6.0 / (inputs + outputs) as f64).sqrt();
    let name = format!("{name}.weight");
    let weight = uniform(&[outputs, inputs], -bound, bound, &mut random.tensor(&name));
    state.insert(name, weight);
}

/// x·Wᵀ with the tensor of [`insert_matrix`].
pub(crate) fn apply_matrix<T: Real>(tape: &mut Tape<T>, model: &Variables, name: &str, x: Var) -> Var {
    let weight = model.get(&format!("{name}.weight"));
    let no_bias = Tensor::zeros([tape.value(weight).rows()]);
    let no_bias = tape.constant(no_bias);
    linear(tape, x, weight, no_bias, Activation::Identity)
}

/// A tensor of uniform random values, equal in every precision.
pub(crate) fn uniform<T: Real>(shape: &[usize], low: f64, high: f64, random: &mut ChaCha8Rng) -> Tensor<T> {
    let draw = |_| T::from_f64(low + (high - low) * random.random::<f64>());
    Tensor::from_vec(shape, (0..shape.iter().product()).map(draw).collect())
}

/// A tensor of normal random values around 0, equal in every precision.
pub(crate) fn normal<T: Real>(shape: &[usize], deviation: f64, random: &mut ChaCha8Rng) -> Tensor<T> {
    let draw = |_| {
        let standard: f64 = StandardNormal.sample(random);
        T::from_f64(deviation * standard)
    };
    Tensor::from_vec(shape, (0..shape.iter().product()).map(draw).collect())
}

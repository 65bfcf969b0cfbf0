//! Fully connected layers as tensors of a model.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use shaders::linear::{Activation, linear};
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::state::{ModelState, Variables};

/// How the first weights are drawn; biases are uniform in ±1/√inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FirstWeights {
    /// Uniform in ±√(6 / (inputs + outputs)) (Glorot and Bengio 2010).
    Xavier,
    /// Zero weights and biases: the layer's output is zero at the start.
    Zero,
}

/// Adds `{name}.weight` [outputs, inputs] and `{name}.bias` [outputs].
pub fn insert_layer<T: Real>(
    state: &mut ModelState<T>,
    name: &str,
    inputs: usize,
    outputs: usize,
    first: FirstWeights,
    random: &mut ChaCha8Rng,
) {
    let (weight_bound, bias_bound) = match first {
        FirstWeights::Xavier => ((6.0 / (inputs + outputs) as f64).sqrt(), (1.0 / inputs as f64).sqrt()),
        FirstWeights::Zero => (0.0, 0.0),
    };
    state.insert(format!("{name}.weight"), uniform(&[outputs, inputs], -weight_bound, weight_bound, random));
    state.insert(format!("{name}.bias"), uniform(&[outputs], -bias_bound, bias_bound, random));
}

/// f(x·Wᵀ + b) with the tensors of [`insert_layer`].
pub fn apply_layer<T: Real>(tape: &mut Tape<T>, model: &Variables, name: &str, x: Var, activation: Activation) -> Var {
    let (weight, bias) = (model.get(&format!("{name}.weight")), model.get(&format!("{name}.bias")));
    linear(tape, x, weight, bias, activation)
}

/// Adds `{name}.weight` [outputs, inputs] of a layer without bias.
pub fn insert_matrix<T: Real>(
    state: &mut ModelState<T>,
    name: &str,
    inputs: usize,
    outputs: usize,
    random: &mut ChaCha8Rng,
) {
    let bound = (6.0 / (inputs + outputs) as f64).sqrt();
    state.insert(format!("{name}.weight"), uniform(&[outputs, inputs], -bound, bound, random));
}

/// x·Wᵀ with the tensor of [`insert_matrix`].
pub fn apply_matrix<T: Real>(tape: &mut Tape<T>, model: &Variables, name: &str, x: Var) -> Var {
    let weight = model.get(&format!("{name}.weight"));
    let no_bias = Tensor::zeros([tape.value(weight).rows()]);
    let no_bias = tape.constant(no_bias);
    linear(tape, x, weight, no_bias, Activation::Identity)
}

/// A tensor of uniform draws, the same in every precision.
pub fn uniform<T: Real>(shape: &[usize], low: f64, high: f64, random: &mut ChaCha8Rng) -> Tensor<T> {
    let draw = |_| T::from_f64(low + (high - low) * random.random::<f64>());
    Tensor::from_vec(shape, (0..shape.iter().product()).map(draw).collect())
}

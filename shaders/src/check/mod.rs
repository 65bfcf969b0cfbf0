//! Comparisons that every kernel must pass. A NaN fails all of them.

pub mod conformance;
pub(crate) mod seeded;
#[cfg(test)]
mod tests;

use std::error::Error;
use std::fmt;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::available_parallelism;

use crate::gpu::{self, AdapterError, Gpu};
use crate::tape::{Device, Real, Tape, Tensor, Var};

/// The step of central differences: the error of truncation (1e-12) and of rounding (1e-10) both stay below [`TOLERANCE`].
const STEP: f64 = 1e-6;

/// The usual tolerance of [`gradients`], relative to the largest gradient.
pub const TOLERANCE: f64 = 1e-6;

/// The first element in which two tensors disagree.
#[derive(Clone, Debug, PartialEq)]
pub struct Mismatch {
    /// `"input 1"`, or `"tensor"`.
    pub what: String,
    /// The index of the element in row-major order.
    pub element: usize,
    /// The value under test.
    pub found: f64,
    /// The reference value.
    pub expected: f64,
    /// The absolute difference that would have been accepted.
    pub allowed: f64,
}

impl fmt::Display for Mismatch {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Mismatch { what, element, found, expected, allowed } = self;
        write!(
            formatter,
            "{what}, element {element}: {found:e} instead of {expected:e} (allowed difference {allowed:e})"
        )
    }
}

impl Error for Mismatch {}

/// Compares the gradients of `f` with central differences in f64, element by element.
///
/// `f` maps variables to one variable of any shape, which is reduced to a number with fixed weights in [−1, 1]. The error
/// of every element must stay within `tolerance` times the largest gradient over all inputs ([`TOLERANCE`] is usual).
/// `f` must be smooth within 1e-6 of the inputs.
pub fn gradients(
    f: impl Fn(&mut Tape<f64>, &[Var]) -> Var,
    inputs: &[Tensor<f64>],
    tolerance: f64,
) -> Result<(), Mismatch> {
    let analytic = analytic_gradients(&f, inputs);
    let numeric: Vec<Vec<f64>> = (0..inputs.len()).map(|input| central_differences(&f, inputs, input)).collect();
    let largest = numeric.iter().flatten().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    let allowed = tolerance * if largest > 0.0 { largest } else { 1.0 };
    for (input, (found, expected)) in analytic.iter().zip(&numeric).enumerate() {
        compare(&format!("input {input}"), found, expected, allowed)?;
    }
    Ok(())
}

/// Compares two tensors of equal shape: every difference must stay within `tolerance` times the largest |expected|
/// (times 1 if all are zero). Shapes that differ panic.
pub fn agree<A: Real, B: Real>(found: &Tensor<A>, expected: &Tensor<B>, tolerance: f64) -> Result<(), Mismatch> {
    assert_eq!(found.shape(), expected.shape(), "agree: shapes differ");
    let to_f64 = |slice: &[B]| slice.iter().map(|value| value.to_f64()).collect::<Vec<_>>();
    let expected = to_f64(expected.as_slice());
    let found: Vec<f64> = found.as_slice().iter().map(|value| value.to_f64()).collect();
    let largest = expected.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    compare("tensor", &found, &expected, tolerance * if largest > 0.0 { largest } else { 1.0 })
}

/// `count` fixed pseudo-random numbers in [−1, 1) (SplitMix64, Steele et al. 2014), different for every `seed`.
pub fn noise(count: usize, seed: u64) -> Vec<f64> {
    let hash = |index: u64| {
        let mut bits = (seed << 32).wrapping_add(index + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^ (bits >> 31)
    };
    let unit = |bits: u64| (bits >> 11) as f64 / (1u64 << 53) as f64;
    (0..count as u64).map(|index| 2.0 * unit(hash(index)) - 1.0).collect()
}

fn compare(what: &str, found: &[f64], expected: &[f64], allowed: f64) -> Result<(), Mismatch> {
    let differs = |(found, expected): (&f64, &f64)| {
        let within = (found - expected).abs() <= allowed && expected.is_finite();
        !within
    };
    match found.iter().zip(expected).position(differs) {
        None => Ok(()),
        Some(element) => {
            let (found, expected) = (found[element], expected[element]);
            Err(Mismatch { what: what.to_owned(), element, found, expected, allowed })
        }
    }
}

fn weights_for(tensor: &Tensor<f64>) -> Tensor<f64> {
    Tensor::from_vec(tensor.shape(), noise(tensor.len(), 0))
}

fn analytic_gradients(f: &impl Fn(&mut Tape<f64>, &[Var]) -> Var, inputs: &[Tensor<f64>]) -> Vec<Vec<f64>> {
    let mut tape = Tape::new(Device::Cpu);
    let vars: Vec<Var> = inputs.iter().map(|input| tape.leaf(input.clone())).collect();
    let output = f(&mut tape, &vars);
    let seed = weights_for(tape.value(output));
    let mut gradients = tape.backward(&[(output, seed)]);
    let zeros = |input: &Tensor<f64>| vec![0.0; input.len()];
    vars.iter().zip(inputs).map(|(&var, input)| gradients.take(var).map_or(zeros(input), Tensor::into_vec)).collect()
}

fn central_differences(f: &impl Fn(&mut Tape<f64>, &[Var]) -> Var, inputs: &[Tensor<f64>], input: usize) -> Vec<f64> {
    let (mut inputs, len) = (inputs.to_vec(), inputs[input].len());
    let objective = |inputs: &[Tensor<f64>]| {
        let mut tape = Tape::new(Device::Cpu);
        let vars: Vec<Var> = inputs.iter().map(|input| tape.constant(input.clone())).collect();
        let output = f(&mut tape, &vars);
        let value = tape.value(output);
        value.as_slice().iter().zip(weights_for(value).as_slice()).map(|(value, weight)| value * weight).sum::<f64>()
    };
    let derivative = |element: usize| {
        let center = inputs[input].as_slice()[element];
        let step = STEP * center.abs().max(1.0);
        inputs[input].make_mut()[element] = center + step;
        let above = objective(&inputs);
        inputs[input].make_mut()[element] = center - step;
        let below = objective(&inputs);
        inputs[input].make_mut()[element] = center;
        (above - below) / (2.0 * step)
    };
    (0..len).map(derivative).collect()
}

/// The adapter for tests, if any: preferably the software driver, because its results are the same on every machine. Without
/// an adapter the test is skipped with a message; with `REQUIRE_ADAPTER=1` it fails.
///
/// A software driver compiles and runs all kernels of a context on one thread, so consecutive tests get different contexts of it.
pub fn test_gpu() -> Option<Gpu> {
    static TESTS: AtomicUsize = AtomicUsize::new(0);
    thread_local! {
        static NUMBER: usize = TESTS.fetch_add(1, Ordering::Relaxed);
    }
    match gpu::adapters().last() {
        Some(adapter) => {
            let contexts = if adapter.is_hardware() { 1 } else { available_parallelism().map_or(1, usize::from) };
            let number = NUMBER.with(|number| number % contexts);
            Some(adapter.open_numbered(number).unwrap_or_else(|error| panic!("{error}")))
        }
        None => {
            let required = std::env::var("REQUIRE_ADAPTER").is_ok_and(|value| value == "1");
            assert!(!required, "REQUIRE_ADAPTER=1: {}", AdapterError::None);
            support::skip(&AdapterError::None.to_string());
            None
        }
    }
}

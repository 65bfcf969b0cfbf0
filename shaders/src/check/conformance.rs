//! Conformance: an adapter must agree with the CPU before a run uses it.

use std::time::Instant;

use crate::arrays::totals;
use crate::check::{Mismatch, agree, noise, seeded};
use crate::gpu::Gpu;
use crate::losses::l1::{self, l1_dssim};
use crate::networks::hexplane::{HexplaneShape, hexplane};
use crate::networks::linear::{Activation, linear};
use crate::pointwise::{self, Expression};
use crate::rasteriser::{self, RasterSettings};
use crate::tape::{Device, Tape, Tensor, Var};

/// Ten times the error of Mesa's exponential (1.1e-6).
const POINTWISE: Tolerance = Tolerance { value: 1e-5, gradient: 1e-5 };
/// Sums over hundreds of rows.
const SUMS: Tolerance = Tolerance { value: 2e-5, gradient: 2e-5 };
/// Sums over hundreds of splats and pixels; nothing jumps, as alpha fades at its threshold.
const SMOOTH_RENDER: Tolerance = Tolerance { value: 1e-4, gradient: 1e-3 };
/// At the edge of a splat, only one device may blend it into a pixel, which changes the pixel by up to one 8-bit level
/// (the alpha threshold). The tolerance of values allows for two such splats.
const RENDER: Tolerance = Tolerance { value: 2.0 / 255.0, gradient: 2e-2 };
/// The pointwise expressions that every training uses.
pub(crate) const EXPRESSIONS: [&[&Expression]; 3] = [pointwise::EXPRESSIONS, l1::EXPRESSIONS, totals::EXPRESSIONS];
/// Elements per expression: several workgroups, the last one not full.
const ELEMENTS: usize = 1000;

/// Largest errors, relative to the largest value or gradient of a tensor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tolerance {
    pub value: f64,
    pub gradient: f64,
}

/// An adapter agrees with the CPU.
#[derive(Clone, Copy, Debug)]
pub struct Conformance {
    /// Comparisons of values or of gradients.
    pub comparisons: usize,
    /// Wall-clock seconds of all comparisons.
    pub secs: f64,
}

/// A result of the adapter that differs from the CPU's.
#[derive(Clone, Debug)]
pub struct Disagreement {
    /// The kernel.
    pub what: String,
    /// The first element that differs.
    pub mismatch: Mismatch,
}

impl std::fmt::Display for Disagreement {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{} differs from the CPU's: {}", self.what, self.mismatch)
    }
}

impl std::error::Error for Disagreement {}

/// Runs the kernels that every training uses, forward and backward on small inputs, and compares with the CPU.
pub fn check(gpu: Gpu) -> Result<Conformance, Disagreement> {
    let (start, mut comparisons) = (Instant::now(), 0);
    for expression in EXPRESSIONS.into_iter().flatten() {
        comparisons += check_expression(gpu, expression)?;
    }
    for (smooth_cutoff, tolerance) in [(true, SMOOTH_RENDER), (false, RENDER)] {
        comparisons += check_render(gpu, smooth_cutoff, tolerance)?;
    }
    comparisons += check_layer(gpu)? + check_field(gpu)? + check_loss(gpu)?;
    Ok(Conformance { comparisons, secs: start.elapsed().as_secs_f64() })
}

/// Value and gradients of an expression.
fn check_expression(gpu: Gpu, expression: &'static Expression) -> Result<usize, Disagreement> {
    let input = |seed: usize| {
        Tensor::from_vec([ELEMENTS], noise(ELEMENTS, seed as u64).iter().map(|x| 3.0 * *x as f32).collect())
    };
    let inputs: Vec<Tensor<f32>> = (0..expression.inputs).map(input).collect();
    let constants = noise(expression.constants, 99);
    let apply = |tape: &mut Tape<f32>, vars: &[Var]| vec![expression.apply(tape, vars, &constants)];
    compare(gpu, expression.name, &inputs, POINTWISE, apply)
}

/// Colour, alpha, depth and features of a seeded scene, and the gradients of all parameters.
fn check_render(gpu: Gpu, smooth_cutoff: bool, tolerance: Tolerance) -> Result<usize, Disagreement> {
    let settings = RasterSettings { smooth_cutoff, depth: true, background: [0.3, 0.1, 0.6], ..Default::default() };
    let camera = seeded::camera(50, 41);
    let mut inputs: Vec<Tensor<f32>> =
        seeded::tensors(&seeded::splats(300, -2.2, 3)).iter().map(Tensor::cast).collect();
    inputs.push(Tensor::from_vec([300, 2], noise(600, 5)).cast());
    let render = |tape: &mut Tape<f32>, vars: &[Var]| {
        let features = Some(vars[5]);
        let rendered = rasteriser::render(tape, &seeded::vars(&vars[..5]), features, &camera, &settings);
        seeded::images(&rendered.expect("a few intersections"))
    };
    let what = if smooth_cutoff { "a render without thresholds" } else { "a render" };
    compare(gpu, what, &inputs, tolerance, render)
}

fn noise_of(shape: &[usize], seed: u64) -> Tensor<f32> {
    Tensor::from_vec(shape, noise(shape.iter().product(), seed)).cast()
}

/// A layer of a network: several tiles, none of them full.
fn check_layer(gpu: Gpu) -> Result<usize, Disagreement> {
    let inputs = [noise_of(&[300, 20], 1), noise_of(&[70, 20], 2), noise_of(&[70], 3)];
    let layer = |tape: &mut Tape<f32>, vars: &[Var]| vec![linear(tape, vars[0], vars[1], vars[2], Activation::Relu)];
    compare(gpu, "a layer", &inputs, SUMS, layer)
}

/// A hexplane field of two scales around 1, which sorts its points.
fn check_field(gpu: Gpu) -> Result<usize, Disagreement> {
    let shape = HexplaneShape { channels: 8, resolution: [6, 7, 5, 4], multipliers: vec![1, 2] };
    let plane = |(seed, shape): (usize, &[usize; 3])| {
        let values = noise(shape.iter().product(), 10 + seed as u64).iter().map(|x| 1.0 + 0.5 * x).collect();
        Tensor::from_vec(shape.as_slice(), values).cast()
    };
    let mut inputs = vec![noise_of(&[300, 3], 1)];
    inputs.extend(shape.plane_shapes().iter().enumerate().map(plane));
    compare(gpu, "a field", &inputs, SUMS, |tape, vars| vec![hexplane(tape, &vars[1..], vars[0], 0.3)])
}

/// The loss of an image.
fn check_loss(gpu: Gpu) -> Result<usize, Disagreement> {
    let [render, target] = [1, 2].map(|seed| {
        let values = noise_of(&[40, 35, 3], seed).into_vec().iter().map(|x| 0.5 + 0.4 * x).collect();
        Tensor::from_vec([40, 35, 3], values)
    });
    compare(gpu, "a loss", &[render], SMOOTH_RENDER, |tape, vars| {
        let target = tape.constant(target.clone());
        vec![l1_dssim(tape, vars[0], target, 0.2)]
    })
}

/// Compares the outputs of `f`, and the gradients of all inputs for fixed gradients of the outputs, on both devices; the
/// number of comparisons.
pub(crate) fn compare(
    gpu: Gpu,
    what: &str,
    inputs: &[Tensor<f32>],
    tolerance: Tolerance,
    f: impl Fn(&mut Tape<f32>, &[Var]) -> Vec<Var>,
) -> Result<usize, Disagreement> {
    let expected = run(Device::Cpu, inputs, &f);
    let compared = || agree_with(&expected, &run(Device::Gpu(gpu), inputs, &f), what, tolerance);
    let comparisons = compared()?;
    #[cfg(test)]
    {
        crate::gpu::joined::tests::compare_joined(compared)?;
        crate::gpu::parts::tests::compare_in_parts(compared)?;
    }
    Ok(comparisons)
}

/// The number of results, if all agree.
fn agree_with(
    expected: &[(String, Tensor<f32>)],
    found: &[(String, Tensor<f32>)],
    what: &str,
    tolerance: Tolerance,
) -> Result<usize, Disagreement> {
    assert_eq!(found.len(), expected.len(), "{what}: one result on each device");
    for ((name, found), (_, expected)) in found.iter().zip(expected) {
        let disagreement = |mismatch| Disagreement { what: format!("{name} of {what}"), mismatch };
        let allowed = if name.starts_with("gradient") { tolerance.gradient } else { tolerance.value };
        agree(found, expected, allowed).map_err(disagreement)?;
    }
    Ok(found.len())
}

/// Outputs, then gradients; zeros for inputs without a gradient.
pub(crate) fn run(
    device: Device,
    inputs: &[Tensor<f32>],
    f: impl Fn(&mut Tape<f32>, &[Var]) -> Vec<Var>,
) -> Vec<(String, Tensor<f32>)> {
    let mut tape = Tape::new(device);
    let vars: Vec<Var> = inputs.iter().map(|input| tape.leaf(input.clone())).collect();
    let outputs = f(&mut tape, &vars);
    let seed = |index: usize, tensor: &Tensor<f32>| {
        let weights = noise(tensor.len(), 500 + index as u64).iter().map(|&weight| weight as f32).collect();
        Tensor::from_vec(tensor.shape(), weights)
    };
    let seeds: Vec<_> =
        outputs.iter().enumerate().map(|(index, &output)| (output, seed(index, tape.value(output)))).collect();
    let mut gradients = tape.backward(&seeds);
    let values = outputs.iter().enumerate().map(|(at, &var)| (format!("output {at}"), tape.value(var).clone()));
    let mut results: Vec<_> = values.collect();
    for (at, (&var, input)) in vars.iter().zip(inputs).enumerate() {
        let gradient = gradients.take(var).unwrap_or_else(|| Tensor::zeros(input.shape()));
        results.push((format!("gradient {at}"), gradient));
    }
    results
}

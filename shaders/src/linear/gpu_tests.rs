//! A GPU computes what the CPU computes, forward and backward.

use super::*;
use crate::check::noise;
use crate::gpu::Gpu;
use crate::gpu::conformance::{Disagreement, Tolerance, compare};
use crate::gpu::fault::assert_noticed;
use crate::gpu::tests::test_gpu;

/// Sums of up to thousands of terms.
const TIGHT: Tolerance = Tolerance { value: 1e-5, gradient: 1e-5 };

fn compare_layer(gpu: Gpu, [rows, inputs, outputs]: [usize; 3], activation: Activation) -> Result<usize, Disagreement> {
    let tensor = |shape: &[usize], seed| Tensor::from_vec(shape, noise(shape.iter().product(), seed)).cast();
    let arguments = [tensor(&[rows, inputs], 1), tensor(&[outputs, inputs], 2), tensor(&[outputs], 3)];
    let what = format!("{rows} rows, {inputs} to {outputs}, {activation:?}");
    compare(gpu, &what, &arguments, TIGHT, |tape, vars| vec![linear(tape, vars[0], vars[1], vars[2], activation)])
}

#[test]
fn a_gpu_has_layers_of_every_size() {
    let Some(gpu) = test_gpu() else { return };
    for activation in [Activation::Identity, Activation::Relu] {
        for sizes in [[0, 4, 3], [1, 1, 1], [5, 3, 7], [64, 64, 64], [65, 17, 66], [700, 40, 3], [2000, 70, 130]] {
            compare_layer(gpu, sizes, activation).unwrap();
        }
    }
}

#[test]
fn a_gpu_with_another_layer_is_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("linear", "value += bias[column]", "value += bias[0]"),
        ("linear", "output[at] <= 0.0", "output[at] <= 0.1"),
        ("linear", "row_sums += rows", "row_sums += 1.001 * rows"),
        ("linear", "step += STEP", "step += STEP + 1u"),
        ("linear", "term >= end", "term + 1u >= end"),
    ];
    assert_noticed(&faults, || compare_layer(gpu, [1100, 20, 9], Activation::Relu));
}

#[test]
fn two_runs_of_a_layer_on_a_gpu_give_equal_bytes() {
    let Some(gpu) = test_gpu() else { return };
    let run = || {
        let mut tape = Tape::<f32>::new(crate::tape::Device::Gpu(gpu));
        let mut leaf =
            |shape: [usize; 2], seed| tape.leaf(Tensor::from_vec(shape, noise(shape[0] * shape[1], seed)).cast());
        let (x, weight, bias) = (leaf([3000, 20], 1), leaf([30, 20], 2), leaf([30, 1], 3));
        let y = linear(&mut tape, x, weight, bias, Activation::Relu);
        let mut gradients = tape.backward(&[(y, Tensor::full([3000, 30], 0.3))]);
        [
            tape.value(y).clone(),
            gradients.take(x).unwrap(),
            gradients.take(weight).unwrap(),
            gradients.take(bias).unwrap(),
        ]
    };
    assert_eq!(run(), run());
}

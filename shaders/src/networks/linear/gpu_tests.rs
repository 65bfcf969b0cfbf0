//! A GPU computes what the CPU computes, forward and backward.

use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare};
use crate::check::noise;
use crate::gpu::Gpu;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::grouped::tests::with_arrays;
use crate::gpu::tests::test_gpu;
use crate::tape::Device;

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
        ("linear", "value += side(item, column)", "value += side(item, 0u)"),
        ("linear", "gather_side(item, safe) <= vec4<f32>()", "gather_side(item, safe) <= vec4<f32>(0.1)"),
        ("linear", "row_sums += rows", "row_sums += 1.001 * rows"),
        ("linear", "constants_of(item).has_sums == 1u", "constants_of(item).has_sums == 0u"),
        ("linear", "step += STEP", "step += STEP + 1u"),
        ("linear", "terms[four] < end", "terms[four] + 1u < end"),
        ("products, parts", "vec4<u32>(0u, 1u, 2u, 3u)", "vec4<u32>(0u, 1u, 2u, 2u)"),
        ("products, parts", "var part = whole", "var part = whole + 1u"),
    ];
    assert_noticed(&faults, || compare_layer(gpu, [2100, 20, 9], Activation::Relu));
}

#[test]
fn two_runs_of_a_layer_on_a_gpu_give_equal_bytes() {
    let Some(gpu) = test_gpu() else { return };
    let run = || {
        let mut tape = Tape::<f32>::new(Device::Gpu(gpu));
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

/// A network of heads: layers that share x, and one more layer on each of their outputs except the last, which is not
/// used; x also has another use.
fn heads(tape: &mut Tape<f32>, vars: &[Var], sizes: &[usize]) -> Vec<Var> {
    let (x, tensors) = vars.split_first().unwrap();
    let (inner, outer) = tensors.split_at(2 * sizes.len());
    let layer = |x: Var, pair: &[Var]| Layer { x, weight: pair[0], bias: pair[1] };
    let first: Vec<Layer> = inner.chunks(2).map(|pair| layer(*x, pair)).collect();
    let hidden = linears(tape, &first, Activation::Relu);
    let second: Vec<Layer> = outer.chunks(2).zip(&hidden).map(|(pair, &x)| layer(x, pair)).collect();
    let mut outputs = linears(tape, &second[..sizes.len() - 1], Activation::Identity);
    outputs.push(crate::pointwise::scale(tape, *x, 0.5));
    outputs
}

/// x, the first layers and the second ones, of `sizes` outputs.
fn tensors_of_heads(rows: usize, inputs: usize, width: usize, sizes: &[usize]) -> Vec<Tensor<f32>> {
    let tensor =
        |seed: usize, shape: [usize; 2]| Tensor::from_vec(shape, noise(shape[0] * shape[1], seed as u64)).cast();
    let inner = sizes.iter().flat_map(|_| [[width, inputs], [1, width]]);
    let outer = sizes.iter().flat_map(|&size| [[size, width], [1, size]]);
    let shapes = std::iter::once([rows, inputs]).chain(inner).chain(outer);
    shapes.enumerate().map(|(seed, shape)| tensor(seed, shape)).collect()
}

fn compare_heads(gpu: Gpu, [rows, inputs, width]: [usize; 3], sizes: &[usize]) -> Result<usize, Disagreement> {
    let what = format!("{rows} rows, {inputs} to {width} to {sizes:?}");
    compare(gpu, &what, &tensors_of_heads(rows, inputs, width, sizes), TIGHT, |tape, vars| heads(tape, vars, sizes))
}

#[test]
fn a_gpu_has_several_layers_at_once() {
    let Some(gpu) = test_gpu() else { return };
    for (shape, sizes) in [([0, 4, 3], &[3, 1][..]), ([1, 1, 1], &[2]), ([130, 66, 20], &[3, 70, 4])] {
        compare_heads(gpu, shape, sizes).unwrap();
    }
    // A layer or two per launch, and all of them.
    for arrays in [4, 9, usize::MAX] {
        with_arrays(arrays, || compare_heads(gpu, [700, 20, 65], &[3, 70, 4, 1])).unwrap();
    }
}

#[test]
fn a_gpu_with_other_layers_is_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("linear, over layers", "of_item < items.y", "of_item + 1u < items.y"),
        ("linear, over layers", "result(item, at) + value", "value"),
        ("products, parts", "set_sums(item, row,", "set_sums(0u, row,"),
    ];
    assert_noticed(&faults, || compare_heads(gpu, [600, 20, 17], &[3, 4, 5]));
}

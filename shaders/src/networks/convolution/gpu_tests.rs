use super::super::{Sampling, central_difference, convolution};
use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare, run};
use crate::check::noise;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::networks::linear::product::assert_valid_product;
use crate::tape::{Device, Tape, Var};

/// Sums over thousands of pixels.
const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 5e-5 };

const SAMPLINGS: [Sampling; 4] = [
    Sampling { stride: 1, dilation: 1, padding: 1 },
    Sampling { stride: 2, dilation: 1, padding: 0 },
    Sampling { stride: 1, dilation: 2, padding: 2 },
    Sampling { stride: 3, dilation: 2, padding: 1 },
];

/// Image, weight and bias of noise.
fn inputs(image: [usize; 3], outputs: usize, [height, width]: [usize; 2]) -> Vec<Tensor<f32>> {
    let tensor = |shape: &[usize], seed| {
        let values = noise(shape.iter().product(), seed).into_iter().map(|value| value as f32);
        Tensor::from_vec(shape, values.collect())
    };
    vec![tensor(&image, 1), tensor(&[outputs, height, width, image[2]], 2), tensor(&[outputs], 3)]
}

fn compare_layers(gpu: Gpu, inputs: &[Tensor<f32>], sampling: Sampling) -> Result<usize, Disagreement> {
    let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![convolution(tape, vars[0], vars[1], vars[2], sampling)];
    compare(gpu, &format!("{sampling:?} of {:?} by {:?}", inputs[0].shape(), inputs[1].shape()), inputs, TOLERANCE, f)
}

/// Central differences of noise for θ = 0.7.
fn compare_central(gpu: Gpu, shape: [usize; 4]) -> Result<usize, Disagreement> {
    let values = noise(shape.iter().product(), 1).into_iter().map(|value| value as f32).collect();
    let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![central_difference(tape, vars[0], 0.7)];
    compare(gpu, &format!("central differences of {shape:?}"), &[Tensor::from_vec(shape, values)], TOLERANCE, f)
}

#[test]
fn kernels_are_valid() {
    for sampling in SAMPLINGS {
        let layout = Layout::new(&[9, 8, 3], &[5, 3, 2, 3], sampling);
        for direction in [Direction::Forward, Direction::Input, Direction::Weight] {
            assert_valid_product(&CONVOLUTION, &layout.specialisation(direction));
        }
    }
    for backward in [0, 1] {
        assert_valid::<CentralBlock>(&CENTRAL, &[("BACKWARD", backward)]);
    }
}

#[test]
fn a_gpu_convolves_as_the_cpu_does() {
    let Some(gpu) = test_gpu() else { return };
    for (image, outputs, kernel) in [([7, 6, 1], 1, [1, 1]), ([23, 19, 5], 7, [3, 3]), ([9, 30, 2], 65, [5, 1])] {
        for sampling in SAMPLINGS {
            compare_layers(gpu, &inputs(image, outputs, kernel), sampling).unwrap();
        }
    }
    // Sums of gradients in several parts.
    compare_layers(gpu, &inputs([50, 41, 6], 8, [3, 3]), SAMPLINGS[0]).unwrap();
}

#[test]
fn a_gpu_takes_central_differences_as_the_cpu_does() {
    let Some(gpu) = test_gpu() else { return };
    for shape in [[1, 1, 1, 1], [4, 3, 3, 2], [33, 5, 3, 7]] {
        compare_central(gpu, shape).unwrap();
    }
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let inputs = inputs([12, 11, 3], 4, [3, 3]);
    let faults = [
        (
            "convolution",
            "tap % KERNEL_WIDTH * DILATION;\n    if (row < PADDING",
            "tap % KERNEL_WIDTH;\n    if (row < PADDING",
        ),
        ("convolution", "at.x >= OUTPUT_HEIGHT", "at.x + 1u >= OUTPUT_HEIGHT"),
        ("convolution", "term % OUTPUTS * TAPS + term / OUTPUTS", "term"),
        ("convolution", "pixel * CHANNELS + column % CHANNELS", "pixel * CHANNELS"),
    ];
    assert_noticed(&faults, || compare_layers(gpu, &inputs, SAMPLINGS[2]));
    let faults = [
        ("central difference", "at == center", "at == first"),
        ("central difference", "difference = weights[center]", "difference = weights[first]"),
    ];
    assert_noticed(&faults, || compare_central(gpu, [4, 3, 3, 2]));
}

#[test]
fn two_runs_give_equal_bytes() {
    let Some(gpu) = test_gpu() else { return };
    let inputs = inputs([45, 33, 8], 16, [3, 3]);
    let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![convolution(tape, vars[0], vars[1], vars[2], SAMPLINGS[0])];
    assert!(run(Device::Gpu(gpu), &inputs, f) == run(Device::Gpu(gpu), &inputs, f));
}

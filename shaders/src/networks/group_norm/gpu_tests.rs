use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare};
use crate::check::noise;
use crate::gpu::column_sums::assert_valid_terms;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::networks::group_norm::group_norm;
use crate::tape::{Tape, Var};

/// Sums over thousands of pixels in f32, which the CPU computes in f64.
const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 2e-5 };

fn compare_layers(gpu: Gpu, shape: [usize; 3], groups: usize) -> Result<usize, Disagreement> {
    let tensor = |shape: &[usize], seed, offset: f64| {
        let values = noise(shape.iter().product(), seed).into_iter().map(|value| (offset + value) as f32);
        Tensor::from_vec(shape, values.collect())
    };
    let inputs = [tensor(&shape, 1, 3.0), tensor(&shape[2..], 2, 1.5), tensor(&shape[2..], 3, 0.0)];
    let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![group_norm(tape, vars[0], vars[1], vars[2], groups)];
    compare(gpu, &format!("{groups} groups of {shape:?}"), &inputs, TOLERANCE, f)
}

#[test]
fn kernels_are_valid() {
    let per_group = ("PER_GROUP", 4);
    for squares in [("SQUARES", 0), ("SQUARES", 1)] {
        assert_valid_terms(&TERMS, &[per_group, squares]);
        assert_valid::<StatisticsBlock>(&STATISTICS, &[per_group, squares, ("LANES", 256)]);
    }
    assert_valid_terms(&BACKWARD_TERMS, &[per_group]);
    assert_valid::<NormBlock>(&FORWARD, &[per_group]);
    assert_valid::<NormBlock>(&BACKWARD, &[per_group]);
}

#[test]
fn a_gpu_normalises_as_the_cpu_does() {
    let Some(gpu) = test_gpu() else { return };
    for (shape, groups) in [([0, 3, 4], 2), ([1, 1, 4], 1), ([3, 5, 6], 3), ([9, 29, 64], 8), ([150, 131, 8], 4)] {
        compare_layers(gpu, shape, groups).unwrap();
    }
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("group norm, terms", "means[channel / PER_GROUP]", "means[0]"),
        ("group norm, statistics", "at < sizes.blocks * PER_GROUP", "at + 1u < sizes.blocks * PER_GROUP"),
        ("group norm", "shift[channel]", "shift[of_group]"),
        ("group norm backward, terms", "vec2<f32>(1.0, normalized)", "vec2<f32>(1.0, 0.999 * normalized)"),
        ("group norm backward", "dy[at] - mean.x", "dy[at] - 0.99 * mean.x"),
    ];
    assert_noticed(&faults, || compare_layers(gpu, [17, 13, 8], 4));
}

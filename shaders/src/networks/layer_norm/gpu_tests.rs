use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare};
use crate::check::noise;
use crate::gpu::column_sums::assert_valid_terms;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::networks::layer_norm::layer_norm;
use crate::tape::{Tape, Var};

/// Sums over hundreds of rows.
const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 2e-5 };

fn compare_layers(gpu: Gpu, rows: usize, columns: usize) -> Result<usize, Disagreement> {
    let tensor = |shape: &[usize], seed, offset: f64| {
        let values = noise(shape.iter().product(), seed).into_iter().map(|value| (offset + value) as f32);
        Tensor::from_vec(shape, values.collect())
    };
    let inputs = [tensor(&[rows, columns], 1, 2.0), tensor(&[columns], 2, 1.5), tensor(&[columns], 3, 0.0)];
    let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![layer_norm(tape, vars[0], vars[1], vars[2])];
    compare(gpu, &format!("a layer of {rows} rows of {columns}"), &inputs, TOLERANCE, f)
}

#[test]
fn kernels_are_valid() {
    for lanes in [1, 16, 256] {
        assert_valid::<NormBlock>(&STANDARDIZE, &[("LANES", lanes)]);
        assert_valid::<NormBlock>(&STANDARDIZE_BACKWARD, &[("LANES", lanes)]);
    }
    for backward in [0, 1] {
        assert_valid::<AffineBlock>(&AFFINE, &[("BACKWARD", backward)]);
    }
    assert_valid_terms(&AFFINE_TERMS, &[]);
}

#[test]
fn a_gpu_normalises_as_the_cpu_does() {
    let Some(gpu) = test_gpu() else { return };
    // Not rows of two: their standardised values are ±1, and gradients cancel down to rounding errors.
    for (rows, columns) in [(0, 4), (1, 3), (63, 6), (65, 32), (700, 33), (3, 1500)] {
        compare_layers(gpu, rows, columns).unwrap();
    }
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("standardize", "EPSILON: f32 = 1e-5", "EPSILON: f32 = 1e-3"),
        ("standardize backward", "- y[at] * by_deviation", "- 0.99 * y[at] * by_deviation"),
        ("affine columns", "value += offset[column]", "value += offset[0]"),
        ("affine columns backward", "vec2<f32>(x[at], 1.0)", "vec2<f32>(x[at], 0.999)"),
        ("affine columns backward", "row += 256u / COLUMNS", "row += 512u / COLUMNS"),
        ("column totals", "block += 256u / COLUMNS", "block += 512u / COLUMNS"),
    ];
    assert_noticed(&faults, || compare_layers(gpu, 3000, 20));
}

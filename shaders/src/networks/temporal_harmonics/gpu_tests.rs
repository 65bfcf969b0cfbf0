use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare};
use crate::check::noise;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::networks::temporal_harmonics::temporal_harmonics;
use crate::tape::{Tape, Var};

const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 1e-5 };

/// Compares the devices on waves of `stored` coefficients, `used` of them in use.
fn compare_waves(gpu: Gpu, rows: usize, waves: usize, [stored, used]: [usize; 2]) -> Result<usize, Disagreement> {
    let tensor = |shape: Vec<usize>, seed| {
        let count = shape.iter().product();
        Tensor::from_vec(shape, noise(count, seed).into_iter().map(|value| value as f32).collect())
    };
    let inputs = [tensor(vec![rows, waves * stored, 3], 1), tensor(vec![rows, 1], 2)];
    let f = |tape: &mut Tape<f32>, vars: &[Var]| {
        vec![temporal_harmonics(tape, vars[0], vars[1], 0.3, stored, used)] //
    };
    compare(gpu, &format!("{waves} waves of {rows} rows"), &inputs, TOLERANCE, f)
}

#[test]
fn kernels_are_valid() {
    assert_valid::<WavesBlock>(&FORWARD, &[]);
    for lanes in [1, 16, 256] {
        assert_valid::<WavesBlock>(&BACKWARD, &[("LANES", lanes)]);
    }
}

#[test]
fn a_gpu_adds_the_waves_that_the_cpu_adds() {
    let Some(gpu) = test_gpu() else { return };
    for rows in [0, 1, 15, 17, 300] {
        for (waves, sizes) in [(2, [16, 16]), (1, [1, 1]), (3, [9, 4])] {
            compare_waves(gpu, rows, waves, sizes).unwrap();
        }
    }
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("temporal harmonics", "f32(wave + 1u)", "f32(wave + 2u)"),
        ("temporal harmonics backward", "at < sizes.used", "at < sizes.stored"),
        ("temporal harmonics backward", "local % LANES < distance", "local % LANES + 1u < distance"),
        ("temporal harmonics backward", "weight = circle.y", "weight = circle.y + 0.001"),
    ];
    assert_noticed(&faults, || compare_waves(gpu, 40, 2, [9, 4]));
}

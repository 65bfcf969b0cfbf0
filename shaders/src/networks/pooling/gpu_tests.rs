use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare};
use crate::check::noise;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::networks::pooling::average_pool;
use crate::tape::{Tape, Var};

const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 1e-5 };

fn compare_pools(gpu: Gpu, shape: [usize; 3], [rows, columns]: [usize; 2]) -> Result<usize, Disagreement> {
    let values = noise(shape.iter().product(), 1).into_iter().map(|value| value as f32).collect();
    let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![average_pool(tape, vars[0], rows, columns)];
    compare(gpu, &format!("{shape:?} to {rows}×{columns}"), &[Tensor::from_vec(shape, values)], TOLERANCE, f)
}

#[test]
fn kernels_are_valid() {
    for lanes in [1, 256] {
        assert_valid::<PoolBlock>(&FORWARD, &[("LANES", lanes)]);
    }
    assert_valid::<PoolBlock>(&BACKWARD, &[]);
}

#[test]
fn a_gpu_pools_as_the_cpu_does() {
    let Some(gpu) = test_gpu() else { return };
    for shape in [[1, 1, 1], [6, 5, 2], [40, 31, 3]] {
        for cells in [[1, 1], [3, 2], [9, 8], [2, 60]] {
            compare_pools(gpu, shape, cells).unwrap();
        }
    }
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("average pool", "min((cell + 1u)", "min((cell + 2u)"),
        ("average pool", "step += LANES", "step += LANES + 1u"),
        ("average pool backward", "column < range.w", "column + 1u < range.w"),
    ];
    assert_noticed(&faults, || compare_pools(gpu, [13, 17, 2], [3, 5]));
}

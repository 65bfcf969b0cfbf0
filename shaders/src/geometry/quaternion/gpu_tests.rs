//! A GPU computes what the CPU computes, forward and backward.

use super::*;
use crate::arrays::rows::validate_map;
use crate::check::conformance::{Tolerance, compare};
use crate::check::noise;
use crate::gpu::tests::test_gpu;
use crate::tape::{Device, Tensor};

/// The derivatives of an arc are quotients of small numbers.
const TIGHT: Tolerance = Tolerance { value: 1e-5, gradient: 1e-4 };

fn tensor(rows: usize, columns: usize, seed: u64) -> Tensor<f32> {
    Tensor::from_vec([rows, columns], noise(rows * columns, seed)).cast()
}

/// Quaternions p and q (the first of them without direction), vectors and shares.
fn inputs(rows: usize) -> [Tensor<f32>; 4] {
    let mut inputs = [tensor(rows, 4, 1), tensor(rows, 4, 2), tensor(rows, 3, 3), tensor(rows, 1, 4)];
    inputs.iter_mut().take(rows.min(2)).for_each(|input| input.make_mut()[..4].fill(1e-8));
    inputs
}

fn all(tape: &mut Tape<f32>, vars: &[Var]) -> Vec<Var> {
    let &[p, q, v, t] = vars else { panic!("four variables") };
    vec![normalize(tape, p), multiply(tape, p, q), rotate(tape, p, v), align(tape, p, q), slerp(tape, p, q, t)]
}

#[test]
fn a_gpu_rotates_and_interpolates() {
    let Some(gpu) = test_gpu() else { return };
    for rows in [0, 1, 64, 300] {
        compare(gpu, &format!("{rows} rows"), &inputs(rows), TIGHT, all).unwrap();
    }
}

#[test]
fn a_gpu_interpolates_along_arc_and_chord() {
    let Some(gpu) = test_gpu() else { return };
    for closeness in [0.5, 0.9, 0.999, 1.0] {
        let [p, far, _, shares] = inputs(50);
        let mix = |(p, far): (&f32, &f32)| closeness * p + (1.0 - closeness) * far;
        let near = Tensor::from_vec([50, 4], p.as_slice().iter().zip(far.as_slice()).map(mix).collect());
        let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![slerp(tape, vars[0], vars[1], vars[2])];
        // Near the end of the arc its sine is 0.03, and quotients by it lose as many digits.
        let tolerance = Tolerance { value: 1e-4, gradient: 1e-3 };
        compare(gpu, &format!("closeness {closeness}"), &[p, near, shares], tolerance, f).unwrap();
    }
}

#[test]
fn a_gpu_that_rotates_the_other_way_is_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let swapped = |tape: &mut Tape<f32>, vars: &[Var]| match tape.device() {
        Device::Cpu => vec![multiply(tape, vars[0], vars[1])],
        Device::Gpu(_) => vec![multiply(tape, vars[1], vars[0])],
    };
    assert!(compare(gpu, "swapped factors", &inputs(50)[..2], TIGHT, swapped).is_err());
}

#[test]
fn the_kernels_are_valid() {
    validate_map(&Normalize, [4]);
    validate_map(&Multiply, [4, 4]);
    validate_map(&Align, [4, 4]);
    validate_map(&Rotate, [4, 3]);
    super::slerp::validate_slerp();
}

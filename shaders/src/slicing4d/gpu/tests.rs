use super::*;
use crate::check::noise;
use crate::gpu::conformance::{Tolerance, compare};
use crate::gpu::fault::assert_noticed;
use crate::gpu::layout::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::rows::RowIndex;
use crate::slicing4d::{Gaussians4dVars, rows_at, slice};
use crate::tape::{Device, Tape, Var};

/// Gradients go through divisions by deviations in time, which differ by orders of magnitude.
const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 1e-4 };
const TIME: f64 = 0.45;

/// Gaussians of all proportions, each twentieth of them of no direction or too short in time.
fn inputs(count: usize) -> Vec<Tensor<f32>> {
    let tensor = |len: usize, seed: u64, factor: f64, offset: f64| {
        let values = noise(count * len, seed).into_iter().map(|value| (offset + factor * value) as f32).collect();
        Tensor::from_vec([count, len], values)
    };
    let mut inputs = vec![
        tensor(3, 1, 0.7, -1.5),
        tensor(1, 2, 0.5, -1.0),
        tensor(4, 3, 1.0, 0.0),
        tensor(4, 4, 1.0, 0.0),
        tensor(1, 5, 0.4, 0.5),
        tensor(1, 6, 4.0, 0.0),
    ];
    for row in (0..count).step_by(20) {
        inputs[2].make_mut()[4 * row..][..4].fill(0.0);
    }
    inputs
}

fn vars(inputs: &[Var]) -> Gaussians4dVars {
    let &[log_scales, log_scales_time, rotations_left, rotations_right, times, opacity_logits] = inputs else {
        panic!("six variables")
    };
    Gaussians4dVars { log_scales, log_scales_time, rotations_left, rotations_right, times, opacity_logits }
}

/// The slices of `rows`, of which the last comes first.
fn sliced(mut rows: Vec<u32>, count: usize) -> impl Fn(&mut Tape<f32>, &[Var]) -> Vec<Var> {
    rows.reverse();
    let index = RowIndex::new(rows, count);
    move |tape, inputs| {
        let sliced = slice(tape, &vars(inputs), TIME, &index);
        vec![sliced.displacements, sliced.velocities, sliced.factors, sliced.opacity_logits]
    }
}

#[test]
fn kernels_are_valid() {
    for kernel in [FORWARD, ROWS] {
        assert_valid::<SlicingBlock>(&kernel, &[]);
    }
    for mask in [0b1111, 0b0100] {
        assert_valid::<SlicingBlock>(&BACKWARD, &[("ARRIVING", mask)]);
    }
}

#[test]
fn a_gpu_slices_what_the_cpu_slices() {
    let Some(gpu) = test_gpu() else { return };
    for count in [0, 1, 63, 64, 65, 500] {
        let rows = (0..count as u32).filter(|row| row % 3 != 1).collect();
        compare(gpu, &format!("{count} slices"), &inputs(count), TOLERANCE, sliced(rows, count)).unwrap();
    }
    compare(gpu, "no slice", &inputs(70), TOLERANCE, sliced(Vec::new(), 70)).unwrap();
}

#[test]
fn gradients_of_single_outputs_agree() {
    let Some(gpu) = test_gpu() else { return };
    for output in 0..4 {
        let f = |tape: &mut Tape<f32>, inputs: &[Var]| vec![sliced((0..90).collect(), 90)(tape, inputs)[output]];
        compare(gpu, "one output", &inputs(90), TOLERANCE, f).unwrap();
    }
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("slicing4d", "rotation[3] * scales)", "rotation[3] * scales.yxzw)"),
        ("slicing4d", "e + rest", "e + 0.999 * rest"),
        ("slicing4d backward", "g_deviation -= g", "g_deviation -= 1.01 * g"),
        ("slicing4d backward", "inverse * inverse * inverse", "inverse * inverse"),
        ("slicing4d backward", "let item = items[start]", "let item = row * arrayLength(&items) / slicing.count"),
    ];
    let inputs = inputs(100);
    let rows: Vec<u32> = (0..100).step_by(2).collect();
    assert_noticed(&faults, || compare(gpu, "slices", &inputs, TOLERANCE, sliced(rows.clone(), 100)));
}

#[test]
fn a_gpu_leaves_out_the_rows_that_the_cpu_leaves_out() {
    let Some(gpu) = test_gpu() else { return };
    for count in [0, 1, 31, 33, 256, 257, 3000] {
        let rows = |device| {
            let mut tape = Tape::new(device);
            let vars = vars(&inputs(count).into_iter().map(|input| tape.constant(input)).collect::<Vec<_>>());
            rows_at(&tape, &vars, TIME, 0.5)
        };
        let (found, expected) = (rows(Device::Gpu(gpu)), rows(Device::Cpu));
        assert_eq!(found, expected);
        assert!(count < 3000 || (300..2700).contains(&found.len()), "{} rows", found.len());
    }
}

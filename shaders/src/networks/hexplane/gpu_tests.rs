//! A GPU computes what the CPU computes, forward and backward.

use super::tests::{distance_to_one, smoothness};
use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare, run};
use crate::check::noise;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::grouped::tests::with_arrays;
use crate::gpu::tests::test_gpu;
use crate::tape::Device;

/// Products of six values; sums over hundreds of points.
const TIGHT: Tolerance = Tolerance { value: 1e-5, gradient: 2e-5 };

/// Positions (some of them outside the field), then all planes around 1.
fn inputs(shape: &HexplaneShape, points: usize, spread: f64) -> Vec<Tensor<f32>> {
    let positions = noise(3 * points, 7).iter().map(|x| spread * x).collect();
    let plane = |(seed, shape): (usize, [usize; 3])| {
        let values = noise(shape.iter().product(), 10 + seed as u64).iter().map(|x| 1.0 + 0.5 * x).collect();
        Tensor::from_vec(shape, values).cast()
    };
    let planes = shape.plane_shapes().into_iter().enumerate().map(plane);
    std::iter::once(Tensor::from_vec([points, 3], positions).cast()).chain(planes).collect()
}

fn compare_fields(gpu: Gpu, shape: &HexplaneShape, points: usize, time: f64) -> Result<usize, Disagreement> {
    let field = |tape: &mut Tape<f32>, vars: &[Var]| vec![hexplane(tape, &vars[1..], vars[0], time)];
    let what = format!("{points} points in {shape:?} at {time}");
    // Spread over the field, and all in a few cells.
    compare(gpu, &what, &inputs(shape, points, 1.3), TIGHT, field)?;
    compare(gpu, &what, &inputs(shape, points, 0.05), TIGHT, field)?;
    // As in a training: positions and some of the planes have other uses.
    let what = format!("{what}, and other uses");
    compare(gpu, &what, &inputs(shape, points, 1.3), TIGHT, |tape, vars| {
        let features = hexplane(tape, &vars[1..], vars[0], time);
        let halved = crate::pointwise::scale(tape, vars[0], 0.5);
        vec![features, halved, smoothness(tape, &vars[2..5]), distance_to_one(tape, &vars[3..])]
    })
}

#[test]
fn a_gpu_reads_fields_of_every_shape() {
    let Some(gpu) = test_gpu() else { return };
    let shapes = [
        (16, [4, 5, 3, 6], vec![1, 2]),
        (3, [7, 2, 9, 1], vec![1]),
        (32, [1, 8, 5, 4], vec![1, 3, 2]),
        // More points per workgroup than it has invocations for their axes.
        (2, [4, 5, 3, 6], vec![1, 2]),
        (1, [4, 5, 3, 6], vec![1]),
    ];
    for (channels, resolution, multipliers) in shapes {
        let shape = HexplaneShape { channels, resolution, multipliers };
        for (points, time) in [(0, 0.3), (1, -1.0), (300, 0.123), (1500, 1.0)] {
            compare_fields(gpu, &shape, points, time).unwrap();
        }
        // One scale per launch, and two.
        for arrays in [10, 16] {
            with_arrays(arrays, || compare_fields(gpu, &shape, 300, 0.123)).unwrap();
        }
    }
}

#[test]
fn a_gpu_reads_fields_of_more_channels_than_a_workgroup_has_invocations() {
    let Some(gpu) = test_gpu() else { return };
    let shape = HexplaneShape { channels: 300, resolution: [4, 3, 3, 2], multipliers: vec![1, 2] };
    for points in [1, 70] {
        compare_fields(gpu, &shape, points, 0.123).unwrap();
    }
}

#[test]
fn a_gpu_that_reads_fields_otherwise_is_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let shape = HexplaneShape { channels: 8, resolution: [4, 5, 3, 6], multipliers: vec![1, 2] };
    let faults = [
        ("hexplane", "(unclamped > last)", "(unclamped > last - 0.1)"),
        ("hexplane backward", "r.yz.along_b", "r.yz.along_a"),
        ("hexplane backward", "scale < ITEMS", "scale + 1u < ITEMS"),
        ("hexplane backward", "sum += g_positions[at]", "sum += 0.0"),
        ("hexplane, blocks", "(1.0 - b) * a,", "(1.0 - b) * b,"),
        ("hexplane, cells", "* cells(scale, width)", "* (cells(scale, width) + 1u)"),
        ("hexplane, texels", "block <= (end", "block < (end"),
        ("hexplane, texels", "b == own.time_high", "b == own.time_low"),
        ("hexplane, texels", "gradient_so_far(scale, plane, element) + gradient", "gradient"),
    ];
    assert_noticed(&faults, || compare_fields(gpu, &shape, 300, 0.3));
}

#[test]
fn two_runs_of_a_field_on_a_gpu_give_equal_bytes() {
    let Some(gpu) = test_gpu() else { return };
    let shape = HexplaneShape { channels: 16, resolution: [8, 8, 8, 5], multipliers: vec![1, 2] };
    let field = |tape: &mut Tape<f32>, vars: &[Var]| vec![hexplane(tape, &vars[1..], vars[0], 0.1)];
    let results = || run(Device::Gpu(gpu), &inputs(&shape, 2000, 0.4), field);
    assert_eq!(results(), results());
}

#[test]
fn a_nan_position_on_a_gpu_gives_nan_features_and_leaves_the_others() {
    let Some(gpu) = test_gpu() else { return };
    let shape = HexplaneShape { channels: 8, resolution: [4, 5, 3, 6], multipliers: vec![1] };
    let features = |inputs: &[Tensor<f32>]| {
        let mut tape = Tape::new(Device::Gpu(gpu));
        let vars: Vec<Var> = inputs.iter().map(|input| tape.leaf(input.clone())).collect();
        let y = hexplane(&mut tape, &vars[1..], vars[0], 0.0);
        tape.value(y).clone()
    };
    let mut inputs = inputs(&shape, 3, 1.0);
    let clean = features(&inputs);
    inputs[0].make_mut()[4] = f32::NAN;
    let poisoned = features(&inputs);
    assert!(poisoned.row(1).iter().all(|value| value.is_nan()));
    assert!([0, 2].iter().all(|&point| poisoned.row(point) == clean.row(point)));
}

fn compare_regularisers(gpu: Gpu) -> Result<usize, Disagreement> {
    let plane = |(seed, shape): (usize, &[usize; 3])| {
        Tensor::from_vec(shape.as_slice(), noise(shape.iter().product(), seed as u64).iter().map(|x| 1.0 + x).collect())
    };
    let shapes = [[7, 3, 2], [2, 5, 2], [3, 2, 4], [1, 1, 1], [40, 33, 16]];
    let planes: Vec<Tensor<f32>> = shapes.iter().enumerate().map(plane).map(|plane| plane.cast()).collect();
    compare(gpu, "smoothness", &planes, TIGHT, |tape, vars| vec![smoothness(tape, vars)])?;
    compare(gpu, "distance to one", &planes, TIGHT, |tape, vars| vec![distance_to_one(tape, vars)])?;
    compare(gpu, "both, of some", &planes, TIGHT, |tape, vars| {
        vec![distance_to_one(tape, &vars[2..]), smoothness(tape, vars)]
    })?;
    compare(gpu, "three at once", &planes, TIGHT, |tape, vars| {
        let terms = [
            (PlaneMean::SecondDifference, vars[..2].to_vec()),
            (PlaneMean::SecondDifference, vars[3..].to_vec()),
            (PlaneMean::DistanceToOne, vars[1..].to_vec()),
        ];
        plane_means(tape, &terms)
    })
}

#[test]
fn a_gpu_regularises_planes() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("plane means", "- center - center", "- center"),
        ("plane means", "at += 256u", "at += 257u"),
        ("plane means", "plane.first_sum + block", "block"),
        ("plane means", "abs(1.0 - values", "abs(1.01 - values"),
        ("plane means, totals", "run.first + local", "local"),
        ("plane means backward", "row >= 2u", "row >= 3u"),
        ("plane means backward", "value < 1.0", "value < 0.9"),
        ("plane means backward", "dy_distance(item, 0u) *", ""),
    ];
    assert_noticed(&faults, || compare_regularisers(gpu));
    for arrays in [4, 16] {
        with_arrays(arrays, || compare_regularisers(gpu)).unwrap();
    }
}

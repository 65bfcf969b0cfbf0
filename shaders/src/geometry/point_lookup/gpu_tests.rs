use super::super::{PinholeCamera, lookup, project_points, unproject};
use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare, run};
use crate::check::noise;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::tape::{Device, Tape, Var};

const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 5e-5 };
const EDGES: Sampling = Sampling::NearestAcrossEdges { relative: 0.6 };

fn camera() -> PinholeCamera {
    let ((sin_a, cos_a), (sin_b, cos_b)) = (0.4_f64.sin_cos(), (-0.3_f64).sin_cos());
    PinholeCamera {
        width: 8,
        height: 6,
        focal: [9.0, 10.0],
        center: [4.2, 2.9],
        rotation: [[cos_a, 0.0, sin_a], [sin_b * sin_a, cos_b, -sin_b * cos_a], [-cos_b * sin_a, sin_b, cos_b * cos_a]],
        translation: [0.3, -0.2, 2.5],
    }
}

fn tensor(shape: &[usize], seed: u64, factor: f64, offset: f64) -> Tensor<f32> {
    let values = noise(shape.iter().product(), seed).into_iter().map(|value| (offset + factor * value) as f32);
    Tensor::from_vec(shape, values.collect())
}

/// Points before and behind the near plane, and pixels with depths.
fn compare_cameras(gpu: Gpu, count: usize, picked: &[usize]) -> Result<usize, Disagreement> {
    let points = tensor(&[count, 3], 1, 2.5, 0.0);
    let project = |tape: &mut Tape<f32>, vars: &[Var]| {
        let seen = project_points(tape, vars[0], &camera(), 0.5);
        picked.iter().map(|&output| [seen.pixels, seen.depths][output]).collect()
    };
    compare(gpu, &format!("{count} points"), &[points], TOLERANCE, project)?;
    let inputs = [tensor(&[count, 2], 2, 4.0, 4.0), tensor(&[count], 3, 1.0, 2.0)];
    let back = |tape: &mut Tape<f32>, vars: &[Var]| vec![unproject(tape, vars[0], vars[1], &camera())];
    compare(gpu, &format!("{count} pixels"), &inputs, TOLERANCE, back)
}

/// An image, and positions within and outside of it.
fn lookup_inputs([height, width, channels]: [usize; 3], count: usize) -> [Tensor<f32>; 2] {
    let mut pixels = tensor(&[count, 2], 5, 0.6, 0.5);
    for pixel in pixels.make_mut().as_chunks_mut::<2>().0 {
        *pixel = [pixel[0] * width as f32, pixel[1] * height as f32];
    }
    [tensor(&[height, width, channels], 4, 1.0, 1.5), pixels]
}

fn compare_lookups(gpu: Gpu, image: [usize; 3], count: usize, sampling: Sampling) -> Result<usize, Disagreement> {
    let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![lookup(tape, vars[0], vars[1], sampling).values];
    compare(gpu, &format!("{count} positions in {image:?}"), &lookup_inputs(image, count), TOLERANCE, f)
}

#[test]
fn kernels_are_valid() {
    for kernel in [PROJECT, UNPROJECT, UNPROJECT_BACKWARD] {
        assert_valid::<CameraBlock>(&kernel, &[]);
    }
    assert_valid::<CameraBlock>(&PROJECT_BACKWARD, &[("ARRIVING", 0b01)]);
    for edges in [("EDGES", 0), ("EDGES", 1)] {
        for kernel in [LOOKUP, VALID, LOOKUP_BACKWARD] {
            assert_valid::<LookupBlock>(&kernel, &[edges]);
        }
    }
    assert_valid::<CornersBlock>(&IMAGE_BACKWARD, &[]);
}

#[test]
fn a_gpu_sees_points_where_the_cpu_does() {
    let Some(gpu) = test_gpu() else { return };
    for count in [0, 1, 255, 257, 1000] {
        compare_cameras(gpu, count, &[0, 1]).unwrap();
    }
    for output in [0, 1] {
        compare_cameras(gpu, 50, &[output]).unwrap();
    }
}

#[test]
fn a_gpu_looks_up_what_the_cpu_does() {
    let Some(gpu) = test_gpu() else { return };
    for sampling in [Sampling::Bilinear, EDGES] {
        for image in [[1, 1, 2], [1, 7, 1], [6, 8, 3], [40, 1, 2]] {
            for count in [0, 1, 63, 65, 900] {
                compare_lookups(gpu, image, count, sampling).unwrap();
            }
        }
    }
}

#[test]
fn holes_and_positions_outside_are_not_valid_on_either_device() {
    let Some(gpu) = test_gpu() else { return };
    let [mut image, mut pixels] = lookup_inputs([9, 11, 2], 400);
    for (index, value) in image.make_mut().iter_mut().enumerate().step_by(13) {
        *value = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][index % 3];
    }
    pixels.make_mut()[40] = f32::NAN;
    pixels.make_mut()[50] = f32::INFINITY;
    for sampling in [Sampling::Bilinear, EDGES] {
        let found = |device| {
            let mut tape = Tape::new(device);
            let (image, pixels) = (tape.constant(image.clone()), tape.leaf(pixels.clone()));
            let sampled = lookup(&mut tape, image, pixels, sampling);
            let gradients = tape.backward(&[(sampled.values, Tensor::full([400, 2], 1.0))]);
            assert!(gradients.get(pixels).unwrap().is_finite());
            (tape.value(sampled.valid).clone(), tape.value(sampled.values).clone())
        };
        let ((valid, values), expected) = (found(Device::Gpu(gpu)), found(Device::Cpu));
        assert_eq!(valid, expected.0);
        crate::check::agree(&values, &expected.1, 1e-5).unwrap();
        assert!(valid.as_slice().contains(&1.0) && valid.as_slice().contains(&0.0));
    }
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("project points", "p.z > camera.near_view", "p.z > 0.9 * camera.near_view"),
        ("project points backward", "-dot(along, p.xy) / p.z", "dot(along, p.xy) / p.z"),
        ("unproject", "- translation", "- 1.01 * translation"),
        ("unproject backward", "ray_view(pixels[pixel])", "vec3<f32>(0.0, 0.0, 1.0)"),
    ];
    assert_noticed(&faults, || compare_cameras(gpu, 1000, &[0, 1]));
    let faults = [
        ("lookup", "sizes.relative * largest", "0.9 * sizes.relative * largest"),
        ("lookup", "y.weights.y > y.weights.x", "y.weights.y < y.weights.x"),
        ("lookup backward", "-y.slope * x.weights", "y.slope * x.weights"),
        ("lookup backward, image", "at < starts[texel + 1u]", "at + 1u < starts[texel + 1u]"),
    ];
    assert_noticed(&faults, || compare_lookups(gpu, [9, 8, 2], 2000, EDGES));
}

#[test]
fn two_runs_give_equal_bytes() {
    let Some(gpu) = test_gpu() else { return };
    let inputs = lookup_inputs([5, 6, 3], 3000);
    let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![lookup(tape, vars[0], vars[1], Sampling::Bilinear).values];
    assert!(run(Device::Gpu(gpu), &inputs, f) == run(Device::Gpu(gpu), &inputs, f));
}

//! A GPU computes what the CPU computes, forward and backward.

use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare};
use crate::check::noise;
use crate::gpu::Gpu;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::tests::test_gpu;

/// Variances are differences of means of squares.
const TIGHT: Tolerance = Tolerance { value: 1e-5, gradient: 1e-4 };

fn image(shape: [usize; 3], seed: u64) -> Tensor<f32> {
    let values = noise(shape.iter().product(), seed).iter().map(|x| 0.5 + 0.4 * x).collect();
    Tensor::from_vec(shape, values).cast()
}

fn compare_images(gpu: Gpu, shape: [usize; 3], window: Window) -> Result<usize, Disagreement> {
    let target = image(shape, 2);
    compare(gpu, &format!("{shape:?}, {window:?}"), &[image(shape, 1)], TIGHT, |tape, vars| {
        let target = tape.constant(target.clone());
        vec![ssim(tape, vars[0], target, window)]
    })
}

#[test]
fn a_gpu_compares_images_of_every_size() {
    let Some(gpu) = test_gpu() else { return };
    for shape in [[1, 1, 1], [1, 40, 3], [17, 1, 3], [16, 16, 3], [33, 47, 3], [20, 18, 4]] {
        compare_images(gpu, shape, Window::ZeroPadded).unwrap();
    }
    for shape in [[11, 11, 3], [12, 30, 1], [40, 33, 3]] {
        compare_images(gpu, shape, Window::Valid).unwrap();
    }
}

#[test]
fn a_gpu_that_compares_images_otherwise_is_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("ssim", "i32(tile.first_row + place / REACH) - RADIUS", "i32(tile.first_row + place / REACH) - 4"),
        ("ssim", "const C2: f32 = 0.0009", "const C2: f32 = 0.00091"),
        ("ssim", "- y * d_xy", "+ y * d_xy"),
        ("ssim", "column + image.margin <", "column <"),
        ("ssim backward", "2.0 * d_xx", "d_xx"),
        ("ssim backward", "tap < TAPS", "tap + 1u < TAPS"),
    ];
    assert_noticed(&faults, || compare_images(gpu, [30, 21, 3], Window::Valid));
}

#[test]
fn a_render_without_gradient_keeps_nothing_on_a_gpu() {
    let Some(gpu) = test_gpu() else { return };
    let value = |device, is_leaf: bool| {
        let mut tape = Tape::new(device);
        let x = image([20, 18, 3], 1);
        let (x, y) = (if is_leaf { tape.leaf(x) } else { tape.constant(x) }, tape.constant(image([20, 18, 3], 2)));
        let y = ssim(&mut tape, x, y, Window::ZeroPadded);
        tape.value(y).as_slice()[0]
    };
    let device = crate::tape::Device::Gpu(gpu);
    assert_eq!(value(device, false), value(device, true));
    assert!((value(device, false) - value(crate::tape::Device::Cpu, false)).abs() < 1e-6);
}

//! Seeded scenes, on which kernels are compared with each other.

use crate::check::noise;
use crate::geometry::camera::PinholeCamera;
use crate::rasteriser::{Rendered, ShapeVars, SplatTensors, SplatVars};
use crate::tape::{Real, Tensor, Var};

/// A camera 4 units in front of the origin, a little off its axes and centre.
pub(crate) fn camera(width: usize, height: usize) -> PinholeCamera {
    let (sin, cos) = 0.3_f64.sin_cos();
    PinholeCamera {
        width,
        height,
        focal: [1.1 * width as f64, 1.2 * width as f64],
        center: [0.52 * width as f64, 0.47 * height as f64],
        rotation: [[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]],
        translation: [0.1, -0.2, 4.0],
    }
}

/// `count` splats in a cube of half-width 1 whose depths differ, with opacities from 0.2 to 0.8 and harmonics of degree 3.
///
/// `log_scale` is the mean logarithm of the standard deviations; they spread by a factor e^±½.
pub(crate) fn splats(count: usize, log_scale: f64, seed: u64) -> SplatTensors<f64> {
    let random = |kind: u64, len: usize| noise(count * len, 16 * seed + kind);
    let scaled = |kind, len, factor: f64, offset: f64| -> Vec<f64> {
        random(kind, len).into_iter().map(|value| offset + factor * value).collect()
    };
    let mut sh = scaled(4, 48, 0.15, 0.0);
    sh.chunks_exact_mut(48).for_each(|sh| sh[..3].iter_mut().for_each(|value| *value += 0.5));
    SplatTensors {
        positions: Tensor::from_vec([count, 3], random(0, 3)),
        log_scales: Tensor::from_vec([count, 3], scaled(1, 3, 0.5, log_scale)),
        rotations: Tensor::from_vec([count, 4], scaled(2, 4, 1.0, 0.0)),
        opacity_logits: Tensor::from_vec([count, 1], scaled(3, 1, 1.38, 0.0)),
        sh: Tensor::from_vec([count, 16, 3], sh),
    }
}

/// The tensors of splats in the order of [`crate::rasteriser::splats::SplatVars`].
pub(crate) fn tensors<T: Real>(splats: &SplatTensors<T>) -> Vec<Tensor<T>> {
    let SplatTensors { positions, log_scales, rotations, opacity_logits, sh } = splats.clone();
    vec![positions, log_scales, rotations, opacity_logits, sh]
}

/// The variables of splats in that order.
pub(crate) fn vars(vars: &[Var]) -> SplatVars {
    let &[positions, log_scales, rotations, opacity_logits, sh] = vars else { panic!("five variables") };
    SplatVars { positions, shape: ShapeVars::ScaleRotation { log_scales, rotations }, opacity_logits, sh }
}

/// Everything that was rendered: colour, alpha, depth, features.
pub(crate) fn images(rendered: &Rendered) -> Vec<Var> {
    let images = [Some(rendered.color), Some(rendered.alpha), rendered.depth, rendered.features];
    images.into_iter().flatten().collect()
}

//! World points in images: projection to pixels and depth, lookup of image values there, and unprojection.
//!
//! With R and t of `camera_from_world`, (x, y, z) = R·X + t is seen at u = (f_x·x/z + c_x, f_y·y/z + c_y) in depth z,
//! and X = Rᵀ·(z·((u_x − c_x)/f_x, (u_y − c_y)/f_y, 1) − t) is the point behind a pixel. Pixel (i, j) of an image has
//! its centre at (i + ½, j + ½); between the centres an image is interpolated bilinearly, outside the outermost ones it
//! is extended by constants. The targets of points under the flow of a view have their own kernel ([`flow_targets`]).

mod camera_maps;
mod flow_target;
mod gpu;
mod in_view;
mod lookup;
#[cfg(test)]
mod tests;

pub use crate::geometry::camera::PinholeCamera;
use crate::tape::{Device, Real, Tape, Var};
use camera_maps::{Project, Unproject};
pub use flow_target::{FlowMaps, FlowTargets, flow_targets};
pub use in_view::in_view;
use lookup::Lookup;
pub use lookup::Sampling;

/// Points as a camera sees them.
#[derive(Clone, Copy, Debug)]
pub struct PointsInImage {
    /// [N, 2] px; `NOWHERE`, without a gradient, for points nearer than the near plane.
    pub pixels: Var,
    /// `[N]` z in view space, scene units.
    pub depths: Var,
}

/// The pixel position of points that are not in front of the camera: outside every image.
pub(crate) const NOWHERE: f64 = -1.0;

/// Values of an image at N pixel positions.
#[derive(Clone, Copy, Debug)]
pub struct Sampled {
    /// [N, C]; 0, without a gradient, where not valid.
    pub values: Var,
    /// `[N]`: 1 where the position lies within the image and all contributing texels are finite, otherwise 0; a constant.
    pub valid: Var,
}

/// Pixels and depths of points [N, 3] in the world; `near_view` > 0 in scene units.
pub fn project_points<T: Real>(
    tape: &mut Tape<T>,
    points_world: Var,
    camera: &PinholeCamera,
    near_view: f64,
) -> PointsInImage {
    assert!(near_view > 0.0, "the near plane must lie in front of the camera");
    assert_eq!(tape.value(points_world).row_len(), 3, "project_points: points must be [N, 3]");
    let outputs = tape.apply(Project::new(camera, near_view), &[points_world]);
    PointsInImage { pixels: outputs[0], depths: outputs[1] }
}

/// Points [N, 3] in the world behind `pixels` [N, 2] in `depths` `[N]` (z in view space, scene units).
pub fn unproject<T: Real>(tape: &mut Tape<T>, pixels: Var, depths: Var, camera: &PinholeCamera) -> Var {
    let count = tape.value(pixels).rows();
    assert_eq!(tape.value(pixels).len(), 2 * count, "unproject: pixels must be [N, 2]");
    assert_eq!(tape.value(depths).len(), count, "unproject: one depth per pixel");
    tape.apply_one(Unproject::new(camera), &[pixels, depths])
}

/// The image [H, W, C] or [H, W] (C = 1) at `pixels` [N, 2], differentiable in both.
pub fn lookup<T: Real>(tape: &mut Tape<T>, image: Var, pixels: Var, sampling: Sampling) -> Sampled {
    let image_shape = tape.value(image).shape();
    assert!((2..=3).contains(&image_shape.len()), "lookup: an image is [H, W] or [H, W, C], not {image_shape:?}");
    assert_eq!(tape.value(pixels).row_len(), 2, "lookup: pixels must be [N, 2]");
    let op = Lookup::new(image_shape, sampling);
    let [image_value, pixels_value] = [image, pixels].map(|var| tape.value(var));
    let valid = match tape.device() {
        Device::Cpu => op.validity(image_value, pixels_value),
        Device::Gpu(gpu) => op.validity_on_gpu(gpu, image_value, pixels_value),
    };
    let valid = tape.constant(valid);
    let values = tape.apply_one(op, &[image, pixels]);
    Sampled { values, valid }
}

//! Pinhole cameras and rigid transforms.

mod view_volume;

use glam::{DMat3, DMat4, DVec2, DVec3};
use serde::{Deserialize, Serialize};

pub(crate) use view_volume::spread;
pub use view_volume::{Ball, common_view_volume, share_facing_away};

use crate::{Error, Result};

/// Largest deviation of a rotation from orthonormality: above the rounding error of six printed digits, below real
/// skew.
const ORTHONORMAL_TOLERANCE: f64 = 1e-4;

/// A pinhole camera with its pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image size, focal lengths and principal point.
    pub intrinsics: Intrinsics,
    /// Transform from world to view coordinates (x right, y down, z forward).
    pub camera_from_world: RigidTransform,
}

/// Intrinsic parameters of a pinhole camera without lens distortion (images are undistorted on import).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Horizontal focal length in pixels.
    pub focal_x: f64,
    /// Vertical focal length in pixels.
    pub focal_y: f64,
    /// Horizontal position of the principal point in pixels (image centre: width / 2).
    pub center_x: f64,
    /// Vertical position of the principal point in pixels (image centre: height / 2).
    pub center_y: f64,
}

/// A rotation followed by a translation: `y = rotation · x + translation`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RigidTransform {
    /// Orthonormal matrix with determinant +1.
    pub rotation: DMat3,
    /// Translation in scene units.
    pub translation: DVec3,
}

impl Camera {
    /// A camera at `position_world` that looks at `target_world`; `up_world` points upwards in the image.
    pub fn look_at(intrinsics: Intrinsics, position_world: DVec3, target_world: DVec3, up_world: DVec3) -> Self {
        let forward = (target_world - position_world).normalize();
        let right = forward.cross(up_world).normalize();
        let down = forward.cross(right);
        let rotation = DMat3::from_cols(right, down, forward).transpose();
        let camera_from_world = RigidTransform { rotation, translation: -(rotation * position_world) };
        Self { intrinsics, camera_from_world }
    }

    /// The camera centre in world coordinates.
    pub fn position_world(&self) -> DVec3 {
        self.camera_from_world.inverse().translation
    }

    /// Pixel position and view-space depth of a world point; `None` if the point is not in front of the camera.
    pub fn project(&self, point_world: DVec3) -> Option<(DVec2, f64)> {
        let view = self.camera_from_world.apply(point_world);
        let Intrinsics { focal_x, focal_y, center_x, center_y, .. } = self.intrinsics;
        let pixel = DVec2::new(focal_x * view.x / view.z + center_x, focal_y * view.y / view.z + center_y);
        (view.z > 0.0).then_some((pixel, view.z))
    }

    /// The view-space direction through a pixel position, scaled to z = 1.
    pub fn ray_view(&self, pixel: DVec2) -> DVec3 {
        let Intrinsics { focal_x, focal_y, center_x, center_y, .. } = self.intrinsics;
        DVec3::new((pixel.x - center_x) / focal_x, (pixel.y - center_y) / focal_y, 1.0)
    }

    /// The world point behind a pixel position at a depth along the optical axis.
    pub fn unproject(&self, pixel: DVec2, depth_view: f64) -> DVec3 {
        self.camera_from_world.inverse().apply(self.ray_view(pixel) * depth_view)
    }

    /// A camera with this pose and field of view, and an image of `width` × `height` pixels.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        Self { intrinsics: self.intrinsics.resized(width, height), ..*self }
    }

    /// Checks for a non-empty image, positive focal lengths, finite values and an orthonormal right-handed rotation.
    pub fn check(&self) -> Result<()> {
        let Intrinsics { width, height, focal_x, focal_y, center_x, center_y } = self.intrinsics;
        if width == 0 || height == 0 {
            return Err(Error::new(format!("the camera has an empty image ({width}×{height})")));
        }
        if !(focal_x > 0.0 && focal_y > 0.0 && focal_x.is_finite() && focal_y.is_finite()) {
            return Err(Error::new(format!("focal lengths must be positive and finite, not {focal_x} and {focal_y}")));
        }
        if !(center_x.is_finite() && center_y.is_finite()) {
            return Err(Error::new(format!("the principal point is not finite ({center_x}, {center_y})")));
        }
        self.camera_from_world.check()
    }
}

impl Intrinsics {
    /// The intrinsics of the same view in an image of `width` × `height` pixels; each axis is scaled separately.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let (sx, sy) = (f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        Self {
            width,
            height,
            focal_x: self.focal_x * sx,
            focal_y: self.focal_y * sy,
            center_x: self.center_x * sx,
            center_y: self.center_y * sy,
        }
    }
}

impl RigidTransform {
    /// The identity transform.
    pub const IDENTITY: Self = Self { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };

    /// Transforms a point.
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// The inverse transform.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// Converts a homogeneous matrix with the last row (0, 0, 0, 1). The result is unchecked; see
    /// [`RigidTransform::check`].
    pub fn from_matrix(matrix: DMat4) -> Self {
        Self { rotation: DMat3::from_mat4(matrix), translation: matrix.w_axis.truncate() }
    }

    /// Checks that the transform is finite, orthonormal and right-handed.
    pub fn check(&self) -> Result<()> {
        if !(self.rotation.is_finite() && self.translation.is_finite()) {
            return Err(Error::new("the pose is not finite"));
        }
        let deviation = self.deviation();
        if !(deviation <= ORTHONORMAL_TOLERANCE) {
            let message = format!("the rotation of the pose is not orthonormal (deviation {deviation:.2e})");
            let hint = "its columns must have the length 1 and be at right angles: divide by their scale, or write more digits";
            return Err(Error::new(message).hint(hint));
        }
        if !(self.rotation.determinant() > 0.0) {
            let hint = "negate one column of each rotation if the axes of the cameras are left-handed, or one coordinate of \
                        all poses and points if the world is";
            return Err(Error::new("the rotation of the pose is a reflection (determinant -1)").hint(hint));
        }
        Ok(())
    }

    /// How far the matrix R is from orthonormal: the largest entry of |R Rᵀ − I|.
    pub fn deviation(&self) -> f64 {
        let residual = self.rotation * self.rotation.transpose() - DMat3::IDENTITY;
        residual.to_cols_array().iter().fold(0.0_f64, |worst, value| worst.max(value.abs()))
    }
}

#[cfg(test)]
mod tests;

//! The camera model of projections.

/// A pinhole camera: x right, y down, z forward; pixel (i, j) has its centre at (i + ½, j + ½).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PinholeCamera {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal lengths in pixels.
    pub focal: [f64; 2],
    /// Principal point in pixels.
    pub center: [f64; 2],
    /// Rows of the rotation `camera_from_world`.
    pub rotation: [[f64; 3]; 3],
    /// Translation of `camera_from_world` in scene units.
    pub translation: [f64; 3],
}

impl PinholeCamera {
    /// The camera's centre in the world, −Rᵀt.
    pub fn position_world(&self) -> [f64; 3] {
        [0, 1, 2].map(|axis| -(0..3).map(|row| self.rotation[row][axis] * self.translation[row]).sum::<f64>())
    }
}

impl From<&scene::camera::Camera> for PinholeCamera {
    fn from(camera: &scene::camera::Camera) -> Self {
        let intrinsics = camera.intrinsics;
        let pose = camera.camera_from_world;
        Self {
            width: intrinsics.width as usize,
            height: intrinsics.height as usize,
            focal: [intrinsics.focal_x, intrinsics.focal_y],
            center: [intrinsics.center_x, intrinsics.center_y],
            rotation: [0, 1, 2].map(|row| pose.rotation.row(row).to_array()),
            translation: pose.translation.to_array(),
        }
    }
}

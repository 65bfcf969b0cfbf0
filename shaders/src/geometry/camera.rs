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

    /// Where a world position is seen: right and down in pixels, and its depth along z in scene units, which is not positive
    /// behind the camera.
    pub fn project(&self, position_world: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = [0, 1, 2].map(|row| {
            let rotation = self.rotation[row];
            (0..3).map(|axis| rotation[axis] * position_world[axis]).sum::<f64>() + self.translation[row]
        });
        let ([focal_x, focal_y], [center_x, center_y]) = (self.focal, self.center);
        [focal_x * x / z + center_x, focal_y * y / z + center_y, z]
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

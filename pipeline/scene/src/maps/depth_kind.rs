//! The quantity that a depth file stores, and its conversion to inverse depth.

use glam::DVec2;
use serde::{Deserialize, Serialize};

use crate::{Camera, Error, FloatImage, Result, pixels};

/// The quantity that a depth file stores.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DepthKind {
    /// View-space z.
    #[default]
    Z,
    /// Distance from the camera centre.
    RayDistance,
    /// Inverse z up to scale and shift, as relative monocular estimators predict it.
    InverseDepth,
    /// View-space z up to scale and shift: Marigold.
    AffineDepth,
}

impl DepthKind {
    /// Whether values have neither a scale nor a shift in common with the scene.
    pub fn is_relative(self) -> bool {
        matches!(self, Self::InverseDepth | Self::AffineDepth)
    }

    /// The quantity of which converted values ([`Self::inverse_depths`]) are an affine function, from z: z for affine depth,
    /// otherwise 1 / z. The function is its own inverse.
    pub fn affine_quantity(self, z: f64) -> f64 {
        if self == Self::AffineDepth { z } else { 1.0 / z }
    }

    /// Converts decoded values of a view of `camera` to inverse z; `None` where the file has no value: 0 (for
    /// distances) or a value that is not finite. A negative distance is an error.
    ///
    /// Distances are multiplied by `units_per_value` (scene units per stored unit). Relative values are kept as they are.
    pub fn inverse_depths(
        self,
        values: &FloatImage,
        camera: &Camera,
        units_per_value: f64,
    ) -> Result<Vec<Option<f64>>> {
        let inverse_depth = |(value, center): (&f32, DVec2)| {
            let value = f64::from(*value);
            let z = match self {
                Self::InverseDepth | Self::AffineDepth => return Ok(value.is_finite().then_some(value)),
                Self::Z => value * units_per_value,
                Self::RayDistance => value * units_per_value / camera.ray_view(center).length(),
            };
            match value {
                value if value < 0.0 => Err(Error::new(format!("depth {value} is not a distance"))
                    .hint("is it inverse depth, or are the camera axes those of OpenGL?")),
                value if value > 0.0 && value.is_finite() => Ok(Some(1.0 / z)),
                _ => Ok(None),
            }
        };
        let centers = pixels::centers(values.width, values.height);
        values.values.iter().zip(centers).map(inverse_depth).collect()
    }
}

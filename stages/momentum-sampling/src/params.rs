//! How particles are drawn.

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

/// Parameters of the stage `momentum-sampling`. KineticGS gives only the equations; the values are ours, and the lengths
/// are relative so that they hold in any unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Most particles.
    pub count: usize,
    /// Most particles as a share of the pixels that can be unprojected: small images hold few.
    pub pixel_share: f64,
    /// Frames between the canonical one and those that it is compared with; `[1]` is the equations' literal reading, which
    /// misses motion that starts later.
    pub strides: Vec<usize>,
    /// Weight of the momentum energy in the distribution that pixels are drawn from; the rest is uniform, so that a scene
    /// without motion, or one with a spike of noise, is still covered.
    pub energy_weight: f64,
    /// Slope of the depth (sum of the absolute differences to the next pixel right and down, relative to the depth) at
    /// which confidence falls to 1/e.
    pub depth_slope: f64,
    /// Difference between the depth where the flow arrives and that of the point at rest, relative to the latter, at which
    /// confidence falls to 1/e.
    pub depth_error: f64,
    /// Edge of the cubes of which each holds at most one particle, scene units; 0 keeps every particle.
    pub voxel_size: f64,
    /// Of the draw.
    pub seed: u64,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            count: 10_000,
            pixel_share: 0.05,
            strides: vec![1, 2, 4, 8], // motion within a quarter of a second at 30 frames per second
            energy_weight: 0.9,
            depth_slope: 0.05, // a surface at 45° has 1 / (focal length in pixels), an outline far more
            depth_error: 0.05,
            voxel_size: 0.01, // the voxels that anchors start from (Lu et al. 2024)
            seed: 0,
        }
    }
}

impl Params {
    /// Every problem that the types cannot see.
    pub fn problems(&self) -> Vec<ParamProblem> {
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let rising = self.strides.windows(2).all(|pair| pair[0] < pair[1]);
        let strides = rising && self.strides.first().is_some_and(|first| *first >= 1);
        let checks = [
            (self.count == 0, "count", "must be at least 1"),
            (!(self.pixel_share > 0.0 && self.pixel_share <= 1.0), "pixel_share", "must lie in (0, 1]"),
            (!strides, "strides", "must be numbers of at least 1 in rising order, as [1, 2, 4, 8]"),
            (!(0.0..=1.0).contains(&self.energy_weight), "energy_weight", "must lie in [0, 1]"),
            (!positive(self.depth_slope), "depth_slope", "must be a positive number"),
            (!positive(self.depth_error), "depth_error", "must be a positive number"),
            (!(self.voxel_size >= 0.0 && self.voxel_size.is_finite()), "voxel_size", "must be 0 or a positive number"),
        ];
        let problem = |(_, key, message): (bool, &str, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: None,
        };
        checks.into_iter().filter(|check| check.0).map(problem).collect()
    }
}

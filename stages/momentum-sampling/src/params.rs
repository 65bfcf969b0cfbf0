//! Parameters of the stage.

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

/// Parameters of the stage `momentum-sampling`. KineticGS publishes the equations without values; the defaults are
/// ours. Depth limits are relative, so that they hold in any unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Maximum number of particles.
    pub count: usize,
    /// Maximum number of particles as a share of the sampled pixels with depth, which limits small images.
    pub pixel_share: f64,
    /// Distances in frames between the canonical frame and the frames that it is compared with. `[1]` is the literal
    /// reading of the equations, which misses motion that starts later.
    pub strides: Vec<usize>,
    /// Weight of the momentum energy in the sampling distribution. The rest is uniform, so that a scene without motion,
    /// or with a spike of noise, is still covered.
    pub energy_weight: f64,
    /// Slope of the depth at which confidence falls to 1/e: the sum of the absolute differences to the right and lower
    /// neighbours, relative to the depth.
    pub depth_slope: f64,
    /// Deviation at which confidence falls to 1/e: of the change of depth along the flow, relative to the depth of the
    /// static point, from the median of the surrounding pixels.
    pub depth_error: f64,
    /// Edge length of voxels with at most one particle each, in scene units times the unit of the capture's scale, which
    /// is 1 for cameras about 4 units away; 0 keeps every particle.
    pub voxel_size: f64,
    /// Instants whose training views particles are sampled from.
    pub instants: Instants,
    /// Seed of the random draws.
    pub seed: u64,
}

/// Choice of instants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Instants {
    /// The first instant, as in the paper.
    First,
    /// Every instant.
    All,
    /// Every instant if each has a single view, which sees objects from only one side; otherwise the first.
    Auto,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            count: 10_000,
            pixel_share: 0.05,
            strides: vec![1, 2, 4, 8], // motion within a quarter of a second at 30 frames per second
            energy_weight: 0.9,
            depth_slope: 0.05, // a surface at 45° has 1 / (focal length in pixels); outlines have far more
            depth_error: 0.05,
            voxel_size: 0.01, // the voxel size of anchors (Lu et al. 2024)
            instants: Instants::Auto,
            seed: 0,
        }
    }
}

impl Params {
    /// Checks the values that the types do not restrict.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let rising = self.strides.windows(2).all(|pair| pair[0] < pair[1]);
        let strides = rising && self.strides.first().is_some_and(|first| *first >= 1);
        let checks = [
            (self.count == 0, "count", "must be at least 1"),
            (!(self.pixel_share > 0.0 && self.pixel_share <= 1.0), "pixel_share", "must be in (0, 1]"),
            (!strides, "strides", "must be numbers of at least 1 in increasing order, e.g. [1, 2, 4, 8]"),
            (!(0.0..=1.0).contains(&self.energy_weight), "energy_weight", "must be in [0, 1]"),
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

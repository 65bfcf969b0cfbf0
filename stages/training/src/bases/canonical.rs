//! Canonical Gaussians that first learn as if nothing moved, then together with what moves them: the training of
//! Deformable 3D Gaussians (Yang et al. 2024) and of its successors.
//!
//! Two phases, [`WARM_UP`] and [`ALL`]. They are one run of the published loop: step sizes and density control go on where
//! the warm-up left them; only the optimiser's moments start afresh.

use scene::cloud::PointCloud;
use shaders::pointwise;
use shaders::rasteriser::{ShapeVars, SplatVars};
use shaders::tape::{Real, Tape, Var};

use crate::bases::gaussians::{self, AdaptiveDensity, GAUSSIANS};
use crate::method::{Phase, PopulationControl, SceneFacts};
use crate::params::Shared;
use crate::schedule::{LogLinear, stretch};
use crate::state::ModelState;

/// The Gaussians learn as if nothing moved.
pub const WARM_UP: &str = "warm-up";
/// Everything learns.
pub const ALL: &str = "all";

/// The published code multiplies the step sizes of positions by this instead of by the scene's extent.
const POSITION_RATE_FACTOR: f64 = 5.0;

/// The least standard deviation, scene units: the logarithm of nothing is not finite.
const MIN_SCALE: f64 = 1e-9;

pointwise! {
    /// y = ln max(|eˢ + Δ|, floor), the logarithm of a scale s that Δ changes after activation. A covariance knows only the
    /// square of a scale, so its sign has no meaning.
    fn changed_log_scale(s, change) with(floor) -> y {
        return log(max(abs(exp(s) + change), floor));
    }
    gradients(dy) {
        s: {
            let scale = exp(s) + change;
            return select(0.0, dy * exp(s) / scale, abs(scale) > floor);
        }
        change: {
            let scale = exp(s) + change;
            return select(0.0, dy / scale, abs(scale) > floor);
        }
    }
}

/// The canonical Gaussians of a method.
pub struct CanonicalGaussians {
    shared: Shared,
}

impl CanonicalGaussians {
    /// With what all methods understand.
    pub fn new(shared: &Shared) -> Self {
        Self { shared: shared.clone() }
    }

    /// The steps of a phase, before stretching.
    pub fn iterations(&self, phase: &str) -> u64 {
        self.shared.iterations.get(phase).copied().unwrap_or(0)
    }

    /// A phase at its stretched length.
    pub fn phase(&self, name: &'static str) -> Phase {
        Phase { name, iterations: stretch(self.iterations(name), self.shared.schedule_scale) }
    }

    /// Adds the Gaussians on the points.
    pub fn insert<T: Real>(
        &self,
        state: &mut ModelState<T>,
        scene: &SceneFacts,
        points: &PointCloud,
    ) -> anyhow::Result<()> {
        let lone_scale = gaussians::LONE_SCALE * scene.extent;
        gaussians::insert_gaussians(state, GAUSSIANS, points, self.shared.harmonics.degree, lone_scale)
    }

    /// The step sizes of the Gaussians' tensors in [`WARM_UP`] and [`ALL`].
    pub fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        if tensor == "gaussians.positions" {
            let law = self.shared.learning_rates.position.scaled(POSITION_RATE_FACTOR);
            return Some(law.after(self.steps_before(phase)));
        }
        gaussians::learning_rate(&self.shared.learning_rates, GAUSSIANS, tensor, scene)
    }

    /// Density control in [`WARM_UP`] and [`ALL`].
    pub fn population_control(&self, phase: &str, scene: &SceneFacts) -> Box<dyn PopulationControl> {
        let Shared { density, schedule_scale, .. } = &self.shared;
        let white = scene.background == [1.0; 3];
        let control = AdaptiveDensity::new(GAUSSIANS, density, *schedule_scale, white);
        Box::new(control.after(stretch(self.steps_before(phase), *schedule_scale)))
    }

    /// The Gaussians' steps before a phase, before stretching.
    fn steps_before(&self, phase: &str) -> u64 {
        if phase == ALL { self.iterations(WARM_UP) } else { 0 }
    }
}

/// Where canonical Gaussians are at one moment; their scales change after activation.
pub struct Moved {
    /// [N, 3], scene units.
    pub positions: Var,
    /// [N, 4] quaternions, normalised by the rasteriser.
    pub rotations: Var,
    /// [N, 3], added to the standard deviations, scene units; `None` where they stay.
    pub scale_changes: Option<Var>,
}

/// Canonical Gaussians at one moment.
pub fn moved<T: Real>(tape: &mut Tape<T>, canonical: SplatVars, moved: Moved) -> SplatVars {
    let Moved { positions, rotations, scale_changes } = moved;
    let (canonical_scales, _) = scales_and_rotations(&canonical);
    let log_scales = match scale_changes {
        Some(changes) => changed_log_scale(tape, canonical_scales, changes, MIN_SCALE),
        None => canonical_scales,
    };
    SplatVars { positions, shape: ShapeVars::ScaleRotation { log_scales, rotations }, ..canonical }
}

/// Logarithmic scales [N, 3] and raw quaternions [N, 4] of canonical Gaussians.
pub fn scales_and_rotations(canonical: &SplatVars) -> (Var, Var) {
    canonical.shape.scales_and_rotations().expect("canonical Gaussians have scales and rotations")
}

#[cfg(test)]
mod tests {
    use shaders::check::{TOLERANCE, gradients, noise};
    use shaders::tape::{Device, Tensor};

    use super::*;

    #[test]
    fn changed_scales_have_the_gradient_of_central_differences() {
        let scales = Tensor::from_vec([40], noise(40, 1));
        let changes = Tensor::from_vec([40], noise(40, 2).iter().map(|change| 2.0 * change).collect());
        let changed = |tape: &mut Tape<f64>, vars: &[Var]| changed_log_scale(tape, vars[0], vars[1], 1e-2);
        gradients(changed, &[scales, changes], TOLERANCE).unwrap();
    }

    #[test]
    fn scales_that_vanish_or_turn_negative_stay_finite() {
        let mut tape = Tape::<f32>::new(Device::Cpu);
        let scales = tape.leaf(Tensor::zeros([3]));
        let changes = tape.leaf(Tensor::from_vec([3], vec![-1.0, -3.0, 0.0]));
        let changed = changed_log_scale(&mut tape, scales, changes, MIN_SCALE);
        let values = tape.value(changed).as_slice().to_vec();
        assert!((values[0] - 1e-9_f32.ln()).abs() <= 1e-5 && (values[1] - 2.0_f32.ln()).abs() <= 1e-6, "{values:?}");
        assert_eq!(values[2], 0.0);
        let gradients = tape.backward(&[(changed, Tensor::full([3], 1.0))]);
        assert!(gradients.get(scales).unwrap().is_finite() && gradients.get(changes).unwrap().is_finite());
    }
}

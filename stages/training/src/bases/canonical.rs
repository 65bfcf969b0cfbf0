//! Canonical Gaussians that are trained first as a static scene, then together with their motion: the training of
//! Deformable 3D Gaussians (Yang et al. 2024) and its successors.
//!
//! There are two phases, [`WARM_UP`] and [`ALL`]. They are one run of the published loop: learning rates and the schedule of
//! density control continue from the warm-up. The optimizer's moments and the statistics of density control restart.

use scene::cloud::PointCloud;
use shaders::pointwise;
use shaders::rasteriser::{ShapeVars, SplatVars};
use shaders::tape::{Real, Tape, Var};

use crate::bases::gaussians::{self, AdaptiveDensity, GAUSSIANS};
use crate::data::{SceneFacts, Streams};
use crate::method::{Base, Moment, Start, StepHook};
use crate::model::{ModelState, Variables};
use crate::schedule::{LogLinear, Phase, stretch};
use crate::shared::{LearningRates, Shared};

pub(crate) use crate::schedule::WARM_UP;

/// The phase after [`WARM_UP`]: all tensors are trained.
pub(crate) const ALL: &str = "all";

/// The factor on the learning rate of positions, in [`SceneFacts::unit_world`]. The published code uses this constant instead of
/// the scene's extent.
const POSITION_RATE_FACTOR: f64 = 5.0;

/// Minimum standard deviation in [`SceneFacts::unit_world`], because the logarithm of zero is not finite.
const MIN_SCALE: f64 = 1e-9;

pointwise! {
    /// y = ln max(|eˢ + Δ|, floor): the logarithm of a scale s changed by Δ after activation. A covariance contains
    /// only the square of a scale, so its sign has no meaning.
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
pub(crate) struct CanonicalGaussians {
    shared: Shared,
}

impl CanonicalGaussians {
    /// The base with these shared parameters.
    pub(crate) fn new(shared: &Shared) -> Self {
        Self { shared: shared.clone() }
    }

    /// The steps of a phase, before stretching.
    pub(crate) fn iterations(&self, phase: &str) -> u64 {
        self.shared.iterations_of(phase)
    }

    /// A phase at its stretched length.
    pub(crate) fn phase(&self, name: &'static str) -> Phase {
        self.shared.phase(name)
    }

    /// Steps of the Gaussians before a phase, before stretching.
    fn steps_before(&self, phase: &str) -> u64 {
        if phase == ALL { self.iterations(WARM_UP) } else { 0 }
    }
}

impl<T: Real> Base<T> for CanonicalGaussians {
    /// [`WARM_UP`] and [`ALL`].
    fn phases(&self) -> Vec<Phase> {
        [WARM_UP, ALL].map(|name| self.shared.phase(name)).to_vec()
    }

    /// Gaussians on the points.
    fn initialize(&self, start: &Start<'_>, points: &PointCloud, _: Streams) -> anyhow::Result<ModelState<T>> {
        let mut state = ModelState::new();
        gaussians::insert_initial(&mut state, &self.shared, start.scene(), points);
        Ok(state)
    }

    /// The learning rates of the Gaussians. That of the positions does not restart in [`ALL`].
    fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        if tensor == "gaussians.positions" {
            return Some(position_rate(&self.shared.learning_rates, scene).after(self.steps_before(phase)));
        }
        gaussians::learning_rate(&self.shared.learning_rates, GAUSSIANS, tensor, scene)
    }

    /// The canonical Gaussians, without motion.
    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        Ok(gaussians::static_splats(tape, model, GAUSSIANS, moment.sh_degree))
    }

    /// Density control, whose schedule counts the steps of both phases.
    fn hooks(&self, phase: &str, scene: &SceneFacts) -> Vec<Box<dyn StepHook>> {
        let Shared { density, schedule_scale, .. } = &self.shared;
        let white = scene.background == [1.0; 3];
        let control = AdaptiveDensity::new(GAUSSIANS, density, *schedule_scale, white);
        let control = control.with_surveys(&self.shared, phase == ALL);
        vec![Box::new(control.after(stretch(self.steps_before(phase), *schedule_scale)))]
    }
}

/// The learning rate of positions.
pub(crate) fn position_rate(rates: &LearningRates, scene: &SceneFacts) -> LogLinear {
    rates.position.scaled(POSITION_RATE_FACTOR * scene.unit_world)
}

/// Attributes of canonical Gaussians at one moment; scales change after activation.
pub(crate) struct Moved {
    /// [N, 3] positions, scene units.
    pub positions: Var,
    /// [N, 4] quaternions, normalised by the rasteriser.
    pub rotations: Var,
    /// Changes of the scales; `None` for constant scales.
    pub scale_changes: Option<ScaleChanges>,
}

/// Changes of standard deviations.
pub(crate) struct ScaleChanges {
    /// [N, 3] changes, scene units.
    pub changes: Var,
    /// [`SceneFacts::unit_world`].
    pub unit_world: f64,
}

/// Replaces the attributes of canonical Gaussians with those at one moment.
pub(crate) fn moved<T: Real>(tape: &mut Tape<T>, canonical: SplatVars, moved: Moved) -> SplatVars {
    let Moved { positions, rotations, scale_changes } = moved;
    let (canonical_scales, _) = scales_and_rotations(&canonical);
    let log_scales = match scale_changes {
        Some(ScaleChanges { changes, unit_world }) => {
            changed_log_scale(tape, canonical_scales, changes, MIN_SCALE * unit_world)
        }
        None => canonical_scales,
    };
    SplatVars { positions, shape: ShapeVars::ScaleRotation { log_scales, rotations }, ..canonical }
}

/// Logarithmic scales [N, 3] and raw quaternions [N, 4] of canonical Gaussians.
pub(crate) fn scales_and_rotations(canonical: &SplatVars) -> (Var, Var) {
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
    fn zero_and_negative_scales_stay_finite() {
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

    #[test]
    fn the_minimum_scale_follows_the_unit_of_length() {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let mut leaf = |columns: usize, value: f64| tape.leaf(Tensor::full([1, columns], value));
        let (positions, rotations, changes) = (leaf(3, 0.0), leaf(4, 0.5), leaf(3, -1.0));
        let shape = ShapeVars::ScaleRotation { log_scales: leaf(3, 0.0), rotations };
        let canonical = SplatVars { positions, shape, opacity_logits: leaf(1, 0.0), sh: leaf(3, 0.0) };
        let changes = ScaleChanges { changes, unit_world: 1e-6 };
        let moved = moved(&mut tape, canonical, Moved { positions, rotations, scale_changes: Some(changes) });
        let (log_scales, _) = scales_and_rotations(&moved);
        let expected = (1e-6 * MIN_SCALE).ln();
        assert!(tape.value(log_scales).as_slice().iter().all(|scale| (scale - expected).abs() <= 1e-9));
    }
}

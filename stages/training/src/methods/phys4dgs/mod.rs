//! Phys4DGS: a hexplane field with losses that keep velocities, displacements and higher derivatives consistent.

mod flow;
mod losses;
mod observation;
mod settings;
#[cfg(test)]
mod tests;
mod trajectories;

use shaders::tape::Real;

use super::MethodFolder;
use crate::bases::gaussians::GAUSSIANS;
use crate::bases::hexplane::field::{SPATIAL_SMOOTHNESS, TEMPORAL_SMOOTHNESS, TIME_TO_ONE};
use crate::bases::hexplane::{FurtherHead, HexplaneGaussians, HexplaneSettings, MOTION, shared_coarse};
use crate::bases::static_mask::{self, SKIP_STILL};
use crate::clock::LOSSES;
use crate::effects::{Effect, Effects, Loss, Need, SEED_FROM_MASKS};
use crate::method::{Base, Method, Observed, SILHOUETTE, SharedPhase, Step};
use crate::schedule::stretch;
use crate::shared::Shared;
use settings::Phys4dgsSettings;

/// The head that predicts a Gaussian's velocity, v in the paper.
const VELOCITY_HEAD: FurtherHead = ("velocity", 3);
/// The head that predicts the change of the velocity until the next frame, δv in the paper.
const VARIATION_HEAD: FurtherHead = ("velocity_variation", 3);

/// Why the losses of the heads are kept although they affect no render.
const TRAINS_HEADS: &str =
    "equations 3 and 5 to 7 of the paper: the heads learn the motion, which is constant in this loss";

/// Phys4DGS: 4DGaussians with consistent velocities and higher derivatives of motion.
pub(crate) struct Phys4dgs;

impl MethodFolder for Phys4dgs {
    const NAME: &'static str = "phys4dgs";
    const KERNELS: &'static [&'static str] = &["arrays/sample"];
    const LOSSES: &'static [Loss] = &[
        SPATIAL_SMOOTHNESS,
        TEMPORAL_SMOOTHNESS,
        TIME_TO_ONE,
        SILHOUETTE,
        Loss::of("velocity", "velocity").stays(TRAINS_HEADS),
        Loss::of("velocity", "temporal"),
        Loss::of("displacement", "displacement").stays(TRAINS_HEADS),
        Loss::of("higher-order", "acceleration").stays(TRAINS_HEADS),
        Loss::of("higher-order", "jerk").stays(TRAINS_HEADS),
        Loss::of("flow", "flow"),
        Loss::of("flow", "flow_acceleration"),
        Loss::of("flow", "flow_jerk"),
        Loss::of("true-displacement", "true_displacement"),
    ];
    type Settings = Phys4dgsSettings;

    // "We omit the opacity reset" (implementation details of the paper).
    fn shared_defaults() -> Shared {
        let mut shared = HexplaneSettings::shared_defaults();
        shared.density.opacity_reset_interval = 0;
        shared
    }

    fn shared_phases(shared: &Shared, _settings: &Phys4dgsSettings) -> Vec<SharedPhase> {
        vec![shared_coarse(shared)]
    }

    fn effects() -> Vec<Effect> {
        vec![
            MOTION,
            SKIP_STILL,
            SEED_FROM_MASKS,
            Effect::new(
                "velocity",
                "Gaussians have a velocity that agrees with their motion and changes slowly (eqs 3, 10)",
                &[Need::Effect("motion")],
            ),
            Effect::new(
                "displacement",
                "displacements from frame to frame agree with predicted velocities and optical flow (eq 5)",
                &[Need::Flow, Need::Effect("motion")],
            ),
            Effect::new(
                "higher-order",
                "accelerations and jerks agree with predicted and observed changes of velocity (eqs 8, 9)",
                &[Need::Times(4), Need::Flow, Need::Effect("motion")],
            ),
            Effect::new(
                "flow",
                "velocities, displacements, accelerations and jerks agree with optical flow as well (eq 2)",
                &[Need::Flow, Need::Effect("motion")],
            ),
            Effect::new(
                "foreground",
                "only Gaussians in the moving part of a view are compared (section 3.1)",
                &[Need::Layers, Need::Effect("motion")],
            ),
            Effect::new(
                "true-displacement",
                "displacements agree with the exact ones of a synthetic scene (eq 4)",
                &[Need::Velocity, Need::Effect("motion")],
            )
            .off_by_default(),
        ]
    }

    fn idle_loss(settings: &Phys4dgsSettings, time_count: usize) -> Option<(Loss, String)> {
        settings.field.idle_loss(time_count)
    }

    #[cfg(test)]
    fn tiny_settings() -> Phys4dgsSettings {
        Phys4dgsSettings::tiny()
    }

    fn build<T: Real>(shared: &Shared, settings: Phys4dgsSettings) -> Box<dyn Method<T>> {
        Box::new(PhysicalGaussians::new(shared, settings))
    }
}

/// The parts of the method that effects switch on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Parts {
    velocity: bool,
    displacement: bool,
    higher_order: bool,
    flow: bool,
    true_displacement: bool,
    foreground: bool,
}

impl Parts {
    /// Active parts. None without motion; flow only supplements other comparisons, so it needs one of them.
    fn of(effects: &Effects) -> Self {
        let has = |name: &str| effects.has("motion") && effects.has(name);
        let [velocity, displacement, higher_order] = ["velocity", "displacement", "higher-order"].map(has);
        Self {
            velocity,
            displacement,
            higher_order,
            flow: (velocity || displacement || higher_order) && has("flow"),
            true_displacement: has("true-displacement"),
            foreground: has("foreground"),
        }
    }

    fn needs_velocity(self) -> bool {
        self.velocity || self.displacement
    }

    fn needs_variation(self) -> bool {
        self.velocity || self.higher_order
    }

    fn further_heads(self) -> Vec<FurtherHead> {
        let heads = [(self.needs_velocity(), VELOCITY_HEAD), (self.needs_variation(), VARIATION_HEAD)];
        heads.into_iter().filter(|(needed, _)| *needed).map(|(_, head)| head).collect()
    }

    /// Number of frames after the view's own at which the field is evaluated; 0 without comparisons.
    fn frames_ahead(self) -> usize {
        match self {
            Self { higher_order: true, .. } => 3,
            Self { velocity: true, .. } => 2,
            Self { displacement: true, .. } | Self { true_displacement: true, .. } => 1,
            _ => 0,
        }
    }
}

struct PhysicalGaussians {
    base: HexplaneGaussians,
    settings: Phys4dgsSettings,
    parts: Parts,
    /// First and last iteration of `fine` between which the weights grow.
    ramp: [u64; 2],
}

impl PhysicalGaussians {
    fn new(shared: &Shared, settings: Phys4dgsSettings) -> Self {
        let parts = Parts::of(&shared.effects);
        let base = HexplaneGaussians::new(shared, settings.field.clone()).with_further_heads(parts.further_heads());
        let ramp = settings.ramp.map(|iteration| stretch(iteration, shared.schedule_scale));
        Self { base, settings, parts, ramp }
    }

    /// The parts whose losses a step evaluates.
    fn due(&self, iteration: u64) -> Parts {
        let Phys4dgsSettings { flow_interval, higher_order_interval, .. } = self.settings;
        Parts {
            flow: self.parts.flow && iteration.is_multiple_of(flow_interval),
            higher_order: self.parts.higher_order && iteration.is_multiple_of(higher_order_interval),
            ..self.parts
        }
    }

    /// Current share of the loss weights, 0 to 1; 0 in steps without physical losses.
    fn gain(&self, phase: &str, iteration: u64) -> f64 {
        let [first, last] = self.ramp.map(|iteration| iteration as f64);
        match self.base.moves(phase) && self.due(iteration).frames_ahead() > 0 {
            true if iteration as f64 >= last => 1.0,
            true => ((iteration as f64 - first) / (last - first)).max(0.0),
            false => 0.0,
        }
    }
}

impl<T: Real> Method<T> for PhysicalGaussians {
    fn base(&self) -> &dyn Base<T> {
        &self.base
    }

    /// The photometric loss and the physical losses (eq 11) of every view.
    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        let gain = self.gain(step.phase, step.iteration);
        static_mask::count_skipped(step);
        for view in step.views {
            step.clock.enter("motion");
            let moment = step.moment(view);
            let splats = self.base.splats(step.tape, step.model, &moment)?;
            step.raster.depth = gain > 0.0 && self.observes(step, view);
            let rendered = step.compare(&splats, view, Observed::All(GAUSSIANS))?;
            if gain > 0.0 {
                self.physical_losses(step, view, &rendered, gain)?;
            }
        }
        step.clock.enter(LOSSES);
        self.base.regularize(step);
        Ok(())
    }
}

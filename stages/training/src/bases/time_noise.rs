//! Annealed noise on the times of training views, to compensate for wrong poses of real scenes (Yang et al. 2024,
//! Deformable 3D Gaussians, section 3.4: annealing smooth training). SC-GS and MCGS train on real scenes in the same
//! way.

use rand_distr::{Distribution as _, StandardNormal};
use shaders::tape::Real;

use crate::data::TrainingView;
use crate::effects::{Effect, Need};
use crate::method::Step;
use crate::schedule::stretch;

/// The effect of methods with noise on time.
pub(crate) const TIME_NOISE: Effect = Effect::new(
    "time-noise",
    "annealed noise on the times of training views, against wrong poses of real scenes",
    &[Need::Effect("motion")],
)
.off_by_default();

/// The published initial standard deviation, in frame intervals.
pub(crate) const FIRST_TIME_NOISE: f64 = 0.1;
/// The published iteration at which the noise reaches zero.
pub(crate) const TIME_NOISE_UNTIL: u64 = 20_000;

/// The noise of a training, if the effect is on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TimeNoise {
    deviation: f64,
    until: u64,
}

impl TimeNoise {
    /// Noise with an initial standard deviation in frame intervals, until an iteration before stretching.
    pub(crate) fn new(deviation: f64, until: u64) -> Self {
        Self { deviation, until }
    }

    /// The time of a training view with noise; `steps_before` is the number of steps before the phase, before
    /// stretching.
    pub(crate) fn time<T: Real>(&self, step: &mut Step<'_, T>, view: &TrainingView<T>, steps_before: u64) -> f64 {
        let scale = step.shared.schedule_scale;
        let iteration = stretch(steps_before, scale) + step.iteration;
        let left = (1.0 - iteration as f64 / stretch(self.until, scale).max(1) as f64).max(0.0);
        let noise: f64 = StandardNormal.sample(step.random.of("time noise"));
        view.time + noise * self.deviation * left / step.scene.time_count as f64
    }
}

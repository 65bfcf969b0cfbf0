//! 4D-GS (Yang et al. 2024): Gaussians in space and time, rendered as slices at each instant.

mod rigidity;
mod settings;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use scene::cloud::PointCloud;
use shaders::arrays::rows::columns;
use shaders::networks::temporal_harmonics::temporal_harmonics;
use shaders::pointwise::{add, scale};
use shaders::rasteriser::slicing4d::SlicedVars;
use shaders::rasteriser::{ShapeVars, SplatVars};
use shaders::tape::{Real, Tape, Tensor, Var};

use super::MethodFolder;
use crate::bases::gaussians::{self, AdaptiveDensity, GAUSSIANS, active_harmonics};
use crate::bases::{primitives4d, seeds};
use crate::clock::LOSSES;
use crate::data::{SceneFacts, Streams};
use crate::effects::{Effect, Loss};
use crate::method::{Base, Method, Moment, Observed, Start, Step, StepHook, photometric_losses};
use crate::model::{ModelState, Variables};
use crate::schedule::{LogLinear, Phase};
use crate::shared::{BatchGradient, Density, Shared};
use settings::{Settings, Switches};

/// The only phase.
const TRAIN: &str = "train";
/// Number of waves of the colours' Fourier series in addition to the constant (published code).
const WAVES: usize = 2;

/// 4D-GS: Gaussians in space and time, sliced at every instant (Yang et al. 2024).
pub(crate) struct Realtime4dgs;

impl MethodFolder for Realtime4dgs {
    const NAME: &'static str = "realtime4dgs";
    const KERNELS: &'static [&'static str] = &["networks/temporal_harmonics"];
    const LOSSES: &'static [Loss] = &[Loss::of("rigid", "rigid")];
    type Settings = Settings;

    fn shared_defaults() -> Shared {
        let density = Density { batch_gradient: BatchGradient::MeanOverViews, ..Density::default() };
        Shared { iterations: BTreeMap::from([(TRAIN.into(), 30_000)]), batch: 4, density, ..Shared::default() }
    }

    fn effects() -> Vec<Effect> {
        settings::effects()
    }

    #[cfg(test)]
    fn tiny_settings() -> Settings {
        // Large enough to matter next to the photometric loss.
        Settings { clip_length: 2.0, rigid_weight: 10.0, rigid_samples: 4, rigid_neighbors: 3 }
    }

    fn build<T: Real>(shared: &Shared, settings: Settings) -> Box<dyn Method<T>> {
        Box::new(SpaceTimeGaussians { shared: shared.clone(), settings, switches: Switches::new(&shared.effects) })
    }
}

struct SpaceTimeGaussians {
    shared: Shared,
    settings: Settings,
    switches: Switches,
}

impl SpaceTimeGaussians {
    /// The Gaussians sliced at a time, with this many waves of their colours.
    fn slice<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        moment: &Moment<'_>,
        waves: usize,
    ) -> (SplatVars, SlicedVars) {
        let var = |attribute: &str| model.get(&format!("{GAUSSIANS}.{attribute}"));
        let parameters = primitives4d::parameters(model, GAUSSIANS, var("log_scales"));
        let sliced = primitives4d::slice(tape, &parameters, moment.time * self.units_per_clip(moment.scene));
        let splats = SplatVars {
            positions: add(tape, var("positions"), sliced.displacements),
            shape: ShapeVars::Factor(sliced.factors),
            opacity_logits: sliced.opacity_logits,
            sh: self.colors(tape, model, moment, waves),
        };
        (splats, sliced)
    }

    /// Spherical harmonics at a time: constant ones plus the first `waves` waves.
    fn colors<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>, waves: usize) -> Var {
        let var = |attribute: &str| model.get(&format!("{GAUSSIANS}.{attribute}"));
        let degree = moment.sh_degree;
        let constant = var("sh_dc");
        let still = if degree > 0 { active_harmonics(tape, constant, var("sh_rest"), degree) } else { constant };
        if waves == 0 {
            return still;
        }
        let count = (degree + 1).pow(2);
        let active = match waves {
            WAVES => var("sh_waves"),
            fewer => columns(tape, var("sh_waves"), 0..3 * fewer * count),
        };
        let times = self.in_clips(tape, var("times"), moment.scene);
        let changing = temporal_harmonics(tape, active, times, moment.time, count, count);
        add(tape, still, changing)
    }

    /// Adds the loss of the effect `rigid` once: it compares Gaussians at their own times, whatever the views show.
    fn add_rigidity<T: Real>(&self, step: &mut Step<'_, T>) {
        step.clock.enter(LOSSES);
        let [positions, log_scales] =
            ["positions", "log_scales"].map(|name| step.model.get(&format!("{GAUSSIANS}.{name}")));
        let parameters = primitives4d::parameters(step.model, GAUSSIANS, log_scales);
        let velocities = primitives4d::velocities(step.tape, &parameters);
        let (unit_world, random) = (step.scene.unit_world, step.random.of("rigid"));
        let loss = rigidity::loss(step.tape, positions, velocities, &self.settings, unit_world, random);
        loss.into_iter().for_each(|loss| step.add_loss("rigid", self.settings.rigid_weight, loss));
    }

    /// Length of the clip in units of time. Rotations in four dimensions mix lengths and times, so the unit of time
    /// scales with the unit of length.
    fn units_per_clip(&self, scene: &SceneFacts) -> f64 {
        self.settings.clip_length * scene.unit_world
    }

    /// Converts times from units of time to shares of the clip.
    fn in_clips<T: Real>(&self, tape: &mut Tape<T>, times: Var, scene: &SceneFacts) -> Var {
        let length = self.units_per_clip(scene);
        if length == 1.0 { times } else { scale(tape, times, 1.0 / length) }
    }

    /// Number of waves that a step trains: one more for each interval after the one that enables the last degree of the
    /// harmonics.
    fn trained_waves(&self, intervals: u64) -> usize {
        let after_degrees = intervals.saturating_sub(self.shared.harmonics.degree as u64) as usize;
        if self.switches.temporal_color { after_degrees.min(WAVES) } else { 0 }
    }

    /// The waves that a render shows: all once every degree is in use, because waves that were never trained are 0.
    fn shown_waves(&self, degree: usize) -> usize {
        if self.switches.temporal_color && degree >= self.shared.harmonics.degree { WAVES } else { 0 }
    }
}

impl<T: Real> Method<T> for SpaceTimeGaussians {
    fn base(&self) -> &dyn Base<T> {
        self
    }

    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        if !self.switches.motion {
            return photometric_losses(self, step);
        }
        let waves = self.trained_waves(step.harmonics_intervals);
        for view in step.views {
            step.clock.enter("motion");
            let moment = step.moment(view);
            let (splats, sliced) = self.slice(step.tape, step.model, &moment, waves);
            primitives4d::count_skipped(step, "Gaussians of other times", &sliced);
            let rendered = step.render(&splats, None, view, Observed::All(GAUSSIANS))?;
            step.photometric(1.0, rendered.color, view);
        }
        if self.switches.rigid {
            self.add_rigidity(step);
        }
        Ok(())
    }
}

impl<T: Real> Base<T> for SpaceTimeGaussians {
    fn phases(&self) -> Vec<Phase> {
        vec![self.shared.phase(TRAIN)]
    }

    fn initialize(&self, start: &Start<'_>, points: &PointCloud, random: Streams) -> anyhow::Result<ModelState<T>> {
        let mut still = ModelState::new();
        let (degree, count) = (self.shared.harmonics.degree, points.len());
        gaussians::insert_initial(&mut still, &self.shared, start.scene(), points);
        if !self.switches.motion {
            return Ok(still);
        }
        let mut state = ModelState::new();
        let kept = still.into_iter().filter(|(name, _)| !name.ends_with(".rotations"));
        kept.for_each(|(name, tensor)| state.insert(name, tensor));
        let scene = start.scene();
        primitives4d::insert_time(&mut state, GAUSSIANS, count, self.settings.clip_length, scene.unit_world, random);
        if self.switches.temporal_color {
            let coefficients = WAVES * (degree + 1).pow(2);
            state.insert(format!("{GAUSSIANS}.sh_waves"), Tensor::zeros([count, coefficients, 3]));
        }
        if self.shared.has_seeds() {
            seeds::insert_in_space_time(&mut state, &self.shared, start, self.units_per_clip(scene))?;
        }
        Ok(state)
    }

    fn learning_rate(&self, _phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        let rates = &self.shared.learning_rates;
        match tensor.strip_prefix(GAUSSIANS)?.strip_prefix('.')? {
            // Constant, because the published code never applies its schedule for the times.
            "times" => Some(LogLinear::constant(rates.position.start * scene.extent)),
            "log_scales_time" => Some(LogLinear::constant(rates.scale)),
            "rotations_left" | "rotations_right" => Some(LogLinear::constant(rates.rotation)),
            "sh_waves" => Some(LogLinear::constant(rates.sh_rest)),
            _ => gaussians::learning_rate(rates, GAUSSIANS, tensor, scene),
        }
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        if !self.switches.motion {
            return Ok(gaussians::static_splats(tape, model, GAUSSIANS, moment.sh_degree));
        }
        Ok(self.slice(tape, model, moment, self.shown_waves(moment.sh_degree)).0)
    }

    fn hooks(&self, _phase: &str, scene: &SceneFacts) -> Vec<Box<dyn StepHook>> {
        let white = scene.background == [1.0; 3];
        let Shared { density, schedule_scale, .. } = &self.shared;
        let control = AdaptiveDensity::new(GAUSSIANS, density, *schedule_scale, white).with_surveys(&self.shared, true);
        vec![Box::new(if self.switches.motion { control.in_space_time() } else { control })]
    }
}

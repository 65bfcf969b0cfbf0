//! Deformable 3D Gaussians (Yang et al. 2024): a coordinate network moves every canonical Gaussian.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use shaders::geometry::quaternion;
use shaders::pointwise::add;
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape};

use super::MethodFolder;
use crate::bases::canonical::{ALL, CanonicalGaussians, Moved, ScaleChanges, WARM_UP, moved, scales_and_rotations};
use crate::bases::coordinate_mlp::{CoordinateMlp, CoordinateMlpSettings, Head};
use crate::bases::gaussians::GAUSSIANS;
use crate::bases::layers::FirstWeights;
use crate::bases::static_mask::{self, SKIP_STILL};
use crate::bases::time_noise::{FIRST_TIME_NOISE, TIME_NOISE, TIME_NOISE_UNTIL, TimeNoise};
use crate::check::{Checks, Table, fields};
use crate::data::{SceneFacts, Streams, TrainingView};
use crate::effects::{Effect, Loss, Need, SEED_FROM_MASKS};
use crate::method::{Base, Method, Moment, Observed, SILHOUETTE, Start, Step};
use crate::model::{ModelState, Variables};
use crate::schedule::LogLinear;
use crate::shared::Shared;

/// Heads of the network, randomly initialised as published.
const POSITION: Head = Head { name: "position", outputs: 3, first: FirstWeights::FanIn };
const ROTATION: Head = Head { name: "rotation", outputs: 4, first: FirstWeights::FanIn };
const SCALE: Head = Head { name: "scale", outputs: 3, first: FirstWeights::FanIn };

/// Deformable 3D Gaussians: a coordinate network moves canonical Gaussians (Yang et al. 2024).
pub(crate) struct Deformable3dgs;

/// The method's table in a recipe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Settings {
    /// The coordinate network.
    pub network: CoordinateMlpSettings,
    /// Initial standard deviation of the effect `time-noise`, in frame intervals.
    pub time_noise: f64,
    /// Iteration at which the time noise reaches zero.
    pub time_noise_until: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            network: CoordinateMlpSettings::default(),
            time_noise: FIRST_TIME_NOISE,
            time_noise_until: TIME_NOISE_UNTIL,
        }
    }
}

impl Table for Settings {
    fn check(&self) -> Checks {
        Checks::default().table("network", &self.network).not_negative(fields!(self, time_noise))
    }
}

impl MethodFolder for Deformable3dgs {
    const NAME: &'static str = "deformable3dgs";
    const LOSSES: &'static [Loss] = &[SILHOUETTE];
    type Settings = Settings;

    fn shared_defaults() -> Shared {
        Shared { iterations: BTreeMap::from([(WARM_UP.into(), 3000), (ALL.into(), 37_000)]), ..Shared::default() }
    }

    fn effects() -> Vec<Effect> {
        vec![
            Effect::new(
                "motion",
                "a coordinate network moves, rotates and scales the Gaussians",
                &[Need::Times(2), Need::Motion],
            ),
            SKIP_STILL,
            SEED_FROM_MASKS,
            TIME_NOISE,
        ]
    }

    #[cfg(test)]
    fn tiny_settings() -> Settings {
        Settings { network: CoordinateMlpSettings::tiny(), ..Settings::default() }
    }

    fn build<T: Real>(shared: &Shared, settings: Settings) -> Box<dyn Method<T>> {
        // A random first displacement would be longer than a seeded subject.
        let zeroed = |head: Head| if shared.has_seeds() { Head { first: FirstWeights::Zero, ..head } } else { head };
        Box::new(DeformedGaussians {
            canonical: CanonicalGaussians::new(shared),
            network: CoordinateMlp::new(
                "network",
                &settings.network,
                FirstWeights::FanIn,
                &[POSITION, ROTATION, SCALE].map(zeroed),
            ),
            moves: shared.effects.has("motion"),
            time_noise: (shared.effects.has("motion") && shared.effects.has(TIME_NOISE.name))
                .then(|| TimeNoise::new(settings.time_noise, settings.time_noise_until)),
            shared: shared.clone(),
        })
    }
}

struct DeformedGaussians {
    shared: Shared,
    canonical: CanonicalGaussians,
    network: CoordinateMlp,
    moves: bool,
    time_noise: Option<TimeNoise>,
}

impl<T: Real> Method<T> for DeformedGaussians {
    fn base(&self) -> &dyn Base<T> {
        &self.canonical
    }

    fn enter_phase(
        &self,
        phase: &str,
        mut state: ModelState<T>,
        start: &Start<'_>,
        random: Streams,
    ) -> anyhow::Result<ModelState<T>> {
        if self.moves && phase == ALL {
            self.network.insert(&mut state, &start.initial_points(&self.shared)?, random);
            static_mask::insert(&mut state, &self.shared, start)?;
        }
        Ok(state)
    }

    fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        let of_network = || Some(self.network.learning_rate(tensor)?.after(self.canonical.iterations(WARM_UP)));
        Method::<T>::base(self).learning_rate(phase, tensor, scene).or_else(of_network)
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        let canonical = self.canonical.splats(tape, model, moment)?;
        if !self.moves || moment.phase == WARM_UP {
            return Ok(canonical);
        }
        Ok(static_mask::move_some(tape, model, moment, canonical, |tape, some, _| {
            let hidden = self.network.hidden(tape, model, some.positions, &[moment.time]);
            let [shift, growth] = [POSITION, SCALE].map(|head| self.network.lengths(tape, model, head.name, hidden));
            let turn = self.network.head(tape, model, ROTATION.name, hidden);
            let (_, raw_rotations) = scales_and_rotations(&some);
            let unit_rotations = quaternion::normalize(tape, raw_rotations);
            let positions = add(tape, some.positions, shift);
            let rotations = add(tape, unit_rotations, turn);
            let growth = ScaleChanges { changes: growth, unit_world: moment.scene.unit_world };
            moved(tape, some, Moved { positions, rotations, scale_changes: Some(growth) })
        }))
    }

    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        static_mask::count_skipped(step);
        for view in step.views {
            step.clock.enter("motion");
            let time = self.training_time(step, view);
            let moment = Moment { time, ..step.moment(view) };
            let splats = self.splats(step.tape, step.model, &moment)?;
            step.compare(&splats, view, Observed::All(GAUSSIANS))?;
        }
        Ok(())
    }
}

impl DeformedGaussians {
    /// The time of a training view; with the effect `time-noise`, perturbed by noise that decays over the training.
    fn training_time<T: Real>(&self, step: &mut Step<'_, T>, view: &TrainingView<T>) -> f64 {
        match self.time_noise.filter(|_| step.phase == ALL) {
            Some(noise) => noise.time(step, view, self.canonical.iterations(WARM_UP)),
            None => view.time,
        }
    }
}

//! 3D Gaussian splatting without time (Kerbl et al. 2023): what a dynamic method must beat.

use std::collections::BTreeMap;

use rand_chacha::ChaCha8Rng;
use scene::cloud::PointCloud;
use serde::{Deserialize, Serialize};
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape};

use super::MethodFolder;
use crate::bases::gaussians::{self, AdaptiveDensity, GAUSSIANS};
use crate::method::{Method, Moment, Phase, PopulationControl, SceneFacts, Start};
use crate::params::Shared;
use crate::schedule::{LogLinear, stretch};
use crate::state::{ModelState, Variables};

/// The only phase.
const TRAIN: &str = "train";

/// The folder's entry.
pub struct Static3dgs;

/// There is nothing that only this method understands.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {}

impl MethodFolder for Static3dgs {
    const NAME: &'static str = "static3dgs";
    const ABOUT: &'static str = "3D Gaussian splatting, time ignored (Kerbl et al. 2023)";
    type Settings = Settings;

    fn shared_defaults() -> Shared {
        Shared { iterations: BTreeMap::from([(TRAIN.into(), 30_000)]), ..Shared::default() }
    }

    fn build<T: Real>(shared: &Shared, _settings: Settings) -> Box<dyn Method<T>> {
        Box::new(StaticGaussians { shared: shared.clone() })
    }
}

struct StaticGaussians {
    shared: Shared,
}

impl<T: Real> Method<T> for StaticGaussians {
    fn phases(&self) -> Vec<Phase> {
        let iterations = self.shared.iterations.get(TRAIN).copied().unwrap_or(0);
        vec![Phase { name: TRAIN, iterations: stretch(iterations, self.shared.schedule_scale) }]
    }

    fn initialize(
        &self,
        start: &Start<'_>,
        points: &PointCloud,
        _random: &mut ChaCha8Rng,
    ) -> anyhow::Result<ModelState<T>> {
        let mut state = ModelState::new();
        let lone_scale = gaussians::LONE_SCALE * start.scene().extent;
        gaussians::insert_gaussians(&mut state, GAUSSIANS, points, self.shared.harmonics.degree, lone_scale)?;
        Ok(state)
    }

    fn learning_rate(&self, _phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        gaussians::learning_rate(&self.shared.learning_rates, GAUSSIANS, tensor, scene)
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        Ok(gaussians::static_splats(tape, model, GAUSSIANS, moment.sh_degree))
    }

    fn population_controls(&self, _phase: &str, scene: &SceneFacts) -> Vec<Box<dyn PopulationControl>> {
        let white = scene.background == [1.0; 3];
        let Shared { density, schedule_scale, .. } = &self.shared;
        vec![Box::new(AdaptiveDensity::new(GAUSSIANS, density, *schedule_scale, white))]
    }
}

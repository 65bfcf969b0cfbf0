//! Static 3D Gaussian splatting (Kerbl et al. 2023): the baseline for dynamic methods.

use std::collections::BTreeMap;

use scene::cloud::PointCloud;
use serde::{Deserialize, Serialize};
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape};

use super::MethodFolder;
use crate::bases::gaussians::{self, AdaptiveDensity, GAUSSIANS};
use crate::check::{Checks, Table};
use crate::data::{SceneFacts, Streams};
use crate::method::{Base, Method, Moment, Start, StepHook};
use crate::model::{ModelState, Variables};
use crate::schedule::{LogLinear, Phase};
use crate::shared::Shared;

/// The only phase.
const TRAIN: &str = "train";

/// Static 3D Gaussian splatting, which ignores time (Kerbl et al. 2023).
pub(crate) struct Static3dgs;

/// The method's table in a recipe, which is empty.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Settings {}

impl Table for Settings {
    fn check(&self) -> Checks {
        Checks::default()
    }
}

impl MethodFolder for Static3dgs {
    const NAME: &'static str = "static3dgs";
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
    fn base(&self) -> &dyn Base<T> {
        self
    }
}

impl<T: Real> Base<T> for StaticGaussians {
    fn phases(&self) -> Vec<Phase> {
        vec![self.shared.phase(TRAIN)]
    }

    fn initialize(&self, start: &Start<'_>, points: &PointCloud, _: Streams) -> anyhow::Result<ModelState<T>> {
        let mut state = ModelState::new();
        gaussians::insert_initial(&mut state, &self.shared, start.scene(), points);
        Ok(state)
    }

    fn learning_rate(&self, _phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        gaussians::learning_rate(&self.shared.learning_rates, GAUSSIANS, tensor, scene)
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        Ok(gaussians::static_splats(tape, model, GAUSSIANS, moment.sh_degree))
    }

    fn hooks(&self, _phase: &str, scene: &SceneFacts) -> Vec<Box<dyn StepHook>> {
        let white = scene.background == [1.0; 3];
        let Shared { density, schedule_scale, .. } = &self.shared;
        let control = AdaptiveDensity::new(GAUSSIANS, density, *schedule_scale, white);
        vec![Box::new(control.with_surveys(&self.shared, true))]
    }
}

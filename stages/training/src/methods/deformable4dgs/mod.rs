//! 4DGaussians (Wu et al. 2024): the hexplane base and nothing else.

use rand_chacha::ChaCha8Rng;
use scene::cloud::PointCloud;
use shaders::rasteriser::SplatVars;
use shaders::tape::{Real, Tape};

use super::MethodFolder;
use crate::bases::hexplane::{HexplaneGaussians, HexplaneSettings, MOTION, coarse_sharing};
use crate::bases::stillness::{self, SKIP_STILL};
use crate::coarse::CoarseSharing;
use crate::effects::Effect;
use crate::method::{Method, Moment, Phase, PopulationControl, SceneFacts, Start, photometric_losses};
use crate::params::Shared;
use crate::schedule::LogLinear;
use crate::state::{ModelState, Variables};
use crate::step::Step;

/// The folder's entry.
pub struct Deformable4dgs;

impl MethodFolder for Deformable4dgs {
    const NAME: &'static str = "deformable4dgs";
    const ABOUT: &'static str = "4DGaussians: a hexplane field moves canonical Gaussians (Wu et al. 2024)";
    type Settings = HexplaneSettings;

    fn shared_defaults() -> Shared {
        HexplaneSettings::shared_defaults()
    }

    fn effects() -> Vec<Effect> {
        vec![MOTION, SKIP_STILL]
    }

    fn coarse(_shared: &Shared, _settings: &HexplaneSettings) -> Option<CoarseSharing> {
        Some(coarse_sharing())
    }

    fn check(settings: &HexplaneSettings) -> Result<(), String> {
        settings.check()
    }

    #[cfg(test)]
    fn tiny_settings() -> HexplaneSettings {
        HexplaneSettings::tiny()
    }

    fn build<T: Real>(shared: &Shared, settings: HexplaneSettings) -> Box<dyn Method<T>> {
        Box::new(FourDGaussians { base: HexplaneGaussians::new(shared, settings) })
    }
}

struct FourDGaussians {
    base: HexplaneGaussians,
}

impl<T: Real> Method<T> for FourDGaussians {
    fn phases(&self) -> Vec<Phase> {
        self.base.phases()
    }

    fn initialize(
        &self,
        start: &Start<'_>,
        points: &PointCloud,
        _random: &mut ChaCha8Rng,
    ) -> anyhow::Result<ModelState<T>> {
        self.base.initialize(start.scene(), points)
    }

    fn enter_phase(
        &self,
        phase: &str,
        state: ModelState<T>,
        start: &Start<'_>,
        random: &mut ChaCha8Rng,
    ) -> anyhow::Result<ModelState<T>> {
        self.base.enter_phase(phase, state, start, random)
    }

    fn learning_rate(&self, _phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        self.base.learning_rate(tensor, scene)
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        Ok(self.base.splats(tape, model, moment))
    }

    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        photometric_losses(self, step)?;
        self.base.regularize(step);
        stillness::count_skipped(step);
        Ok(())
    }

    fn population_controls(&self, _phase: &str, _scene: &SceneFacts) -> Vec<Box<dyn PopulationControl>> {
        self.base.population_controls()
    }
}

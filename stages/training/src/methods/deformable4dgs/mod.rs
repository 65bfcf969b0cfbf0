//! 4DGaussians (Wu et al. 2024): the plain hexplane base.

use shaders::tape::Real;

use super::MethodFolder;
use crate::bases::hexplane::field::{SPATIAL_SMOOTHNESS, TEMPORAL_SMOOTHNESS, TIME_TO_ONE};
use crate::bases::hexplane::{HexplaneGaussians, HexplaneSettings, MOTION, shared_coarse};
use crate::bases::static_mask::{self, SKIP_STILL};
use crate::effects::{Effect, Loss, SEED_FROM_MASKS};
use crate::method::{Base, Method, SILHOUETTE, SharedPhase, Step, photometric_losses};
use crate::shared::Shared;

/// 4DGaussians: a hexplane field moves canonical Gaussians (Wu et al. 2024).
pub(crate) struct Deformable4dgs;

impl MethodFolder for Deformable4dgs {
    const NAME: &'static str = "deformable4dgs";
    const LOSSES: &'static [Loss] = &[SPATIAL_SMOOTHNESS, TEMPORAL_SMOOTHNESS, TIME_TO_ONE, SILHOUETTE];
    type Settings = HexplaneSettings;

    fn shared_defaults() -> Shared {
        HexplaneSettings::shared_defaults()
    }

    fn effects() -> Vec<Effect> {
        vec![MOTION, SKIP_STILL, SEED_FROM_MASKS]
    }

    fn shared_phases(shared: &Shared, _settings: &HexplaneSettings) -> Vec<SharedPhase> {
        vec![shared_coarse(shared)]
    }

    fn idle_loss(settings: &HexplaneSettings, time_count: usize) -> Option<(Loss, String)> {
        settings.idle_loss(time_count)
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
    fn base(&self) -> &dyn Base<T> {
        &self.base
    }

    /// The photometric loss and the regularisers of the planes.
    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        photometric_losses(self, step)?;
        self.base.regularize(step);
        static_mask::count_skipped(step);
        Ok(())
    }
}

//! Effects that change the result to save time. No paper of the methods has them, so a recipe has to name them.

use super::{Effect, Need};

/// A resolution schedule (Chen et al. 2025: DashGaussian, CVPR): early steps see small images and few Gaussians.
/// Offered by every method whose losses compare renders with images only.
pub(crate) const COARSE_TO_FINE: Effect = Effect::new(
    "coarse-to-fine",
    "early steps render smaller images, and the number of Gaussians grows with their size",
    &[Need::NoMaps],
)
.off_by_default();

/// Pruning by the sensitivity of the images to each Gaussian over time (Tu et al. 2025: SpeeDe3DGS; the score of
/// Speedy-Splat, Hanson et al. 2025). Offered by every method whose moving Gaussians have density control.
pub(crate) const TEMPORAL_PRUNING: Effect = Effect::new(
    "temporal-pruning",
    "rounds that remove the Gaussians to which the images of sampled times are least sensitive",
    &[Need::Effect("motion")],
)
.off_by_default();

/// Density control over several views (Ren et al. 2025: FastGS): Gaussians grow only where sampled views have high errors, and
/// faint ones are removed once growth has ended. Offered by every method whose density control grows Gaussians in its last
/// phase.
pub(crate) const VIEW_CONSISTENT_DENSITY: Effect = Effect::new(
    "view-consistent-density",
    "Gaussians are cloned and split only where sampled views have high errors, and faint ones are removed late",
    &[],
)
.off_by_default();

/// Whether an effect saves time instead of adding to what is simulated.
#[cfg(test)]
pub(crate) fn saves_time(effect: &Effect) -> bool {
    [COARSE_TO_FINE, TEMPORAL_PRUNING, VIEW_CONSISTENT_DENSITY].iter().any(|saving| saving.name == effect.name)
}

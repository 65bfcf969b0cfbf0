//! Units of losses: weights that follow from the gradients of a training instead of from its image size or scene.
//!
//! In its unit, a loss with the weight 1 has the gradient of the photometric loss. The unit is measured in the first steps in
//! which the loss has a gradient, and is constant afterwards. The loss does not act before. Losses without a gradient at the
//! start, e.g. of changes while nothing moves, use the unit of another loss.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::ensure;
use serde::{Deserialize, Serialize};
use shaders::tape::{Tape, Tensor, first_elements};

use super::gradient_norms::gradient_norms;
use super::named_loss::NamedLoss;
use crate::artifact::PHOTOMETRIC;
use crate::model::Variables;

/// The tensor by which gradients are compared.
const REFERENCE: &str = "gaussians.positions";
/// Number of measured steps. The gradients of single steps differ by a factor of ten.
const STEPS: u32 = 8;

/// The units of the losses of a phase, as far as they are known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct LossUnits(BTreeMap<String, Measurement>);

/// Sums over the measured steps of a loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Measurement {
    /// Number of steps.
    steps: u32,
    /// Norms of the gradient of the loss.
    own: f64,
    /// Norms of the photometric gradient.
    photometric: f64,
}

impl LossUnits {
    /// The unit of a loss; `None` until it is known.
    pub(crate) fn unit(&self, loss: &str) -> Option<f64> {
        let Measurement { steps, own, photometric } = *self.0.get(loss)?;
        (steps >= STEPS).then(|| photometric / own)
    }

    /// All known units.
    pub(crate) fn known(&self) -> impl Iterator<Item = (&str, f64)> {
        self.0.keys().filter_map(|loss| Some((loss.as_str(), self.unit(loss)?)))
    }

    /// Adds a step of the losses `unmeasured`, which have no unit yet; `losses` are those of the objective. Waits for the
    /// device.
    pub(crate) fn measure(
        &mut self,
        tape: &mut Tape<f32>,
        losses: &[NamedLoss],
        unmeasured: &[NamedLoss],
        model: &Variables,
    ) -> anyhow::Result<()> {
        let photometric = losses.iter().filter(|loss| loss.name == PHOTOMETRIC);
        let compared: Vec<NamedLoss> = photometric.chain(unmeasured).cloned().collect();
        let (keys, norms) = gradient_norms(tape, &compared, model, |_, _| ());
        let norms: Vec<&Tensor<f32>> = norms.iter().collect();
        let squared = keys.squared_by_loss(first_elements(&norms).into_iter().map(f64::from));
        let norm = |loss: &str| -> anyhow::Result<f64> {
            let tensors = squared.get(loss).into_iter().flatten();
            let norm =
                tensors.filter(|(tensor, _)| *tensor == REFERENCE).map(|(_, squared)| squared).sum::<f64>().sqrt();
            ensure!(norm.is_finite(), "the gradient of the loss `{loss}` is not finite");
            Ok(norm)
        };
        let photometric = norm(PHOTOMETRIC)?;
        for loss in unmeasured.iter().map(|loss| loss.name).collect::<BTreeSet<_>>() {
            self.add(loss, norm(loss)?, photometric);
        }
        Ok(())
    }

    /// Adds a step in which the loss has a gradient.
    fn add(&mut self, loss: &str, own: f64, photometric: f64) {
        if own > 0.0 && photometric > 0.0 {
            let sums = self.0.entry(loss.into()).or_default();
            *sums =
                Measurement { steps: sums.steps + 1, own: sums.own + own, photometric: sums.photometric + photometric };
        }
    }

    /// Units of 1 for these losses.
    #[cfg(test)]
    pub(crate) fn ones<'n>(losses: impl IntoIterator<Item = &'n str>) -> Self {
        let one = Measurement { steps: STEPS, own: 1.0, photometric: 1.0 };
        Self(losses.into_iter().map(|loss| (loss.to_owned(), one)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_the_ratio_of_mean_norms_over_steps_with_a_gradient() {
        let mut units = LossUnits::default();
        for step in 0..STEPS {
            assert_eq!(units.unit("depth"), None);
            units.add("depth", 0.0, 5.0);
            units.add("depth", if step == 0 { 9.0 } else { 1.0 }, 4.0);
        }
        assert_eq!(units.unit("depth"), Some(f64::from(4 * STEPS) / f64::from(STEPS + 8)));
        assert_eq!(units.known().map(|(loss, _)| loss).collect::<Vec<_>>(), ["depth"]);
    }
}

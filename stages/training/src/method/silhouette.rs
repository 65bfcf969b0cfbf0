//! The loss `silhouette` of the effect `seed-from-masks`: the weight of the subject's Gaussians in every pixel against
//! the subject's mask.

use shaders::losses::l1::l1;
use shaders::rasteriser::{Rendered, SplatVars};
use shaders::tape::{Real, Tensor, Var};

use super::{Observed, SEED_LIVES, Step, is_seed};
use crate::data::{TrainingView, mask_image};
use crate::effects::{Loss, SEED_FROM_MASKS};

/// The loss.
pub(crate) const SILHOUETTE: Loss = Loss::of(SEED_FROM_MASKS.name, "silhouette");

impl<T: Real> Step<'_, T> {
    /// Renders a view and compares it with its image ([`Step::photometric`]) and, once the model has seeds, with its
    /// mask ([`Step::silhouette`]). The splats are the model's Gaussians in order. Returns the render.
    pub(crate) fn compare(
        &mut self,
        splats: &SplatVars,
        view: &TrainingView<T>,
        observed: Observed<'_>,
    ) -> anyhow::Result<Rendered> {
        let subject = self.subject(view);
        self.compare_subject(splats, subject, view, observed, 1.0)
    }

    /// [`Step::compare`] of splats of which those of the `subject` are 1 in [N, 1], with a photometric loss times
    /// `weight`. Without a subject, nothing is compared with the mask.
    pub(crate) fn compare_subject(
        &mut self,
        splats: &SplatVars,
        subject: Option<Var>,
        view: &TrainingView<T>,
        observed: Observed<'_>,
        weight: f64,
    ) -> anyhow::Result<Rendered> {
        let rendered = self.render(splats, subject, view, observed)?;
        self.photometric(weight, rendered.color, view);
        rendered.features.into_iter().for_each(|shown| self.silhouette(shown, view));
        Ok(rendered)
    }

    /// [N, 1]: 1 for the Gaussians of the model that descend from seeds, otherwise 0; `None` for a model without seeds
    /// or a view to which [`Step::silhouette`] does not apply.
    pub(crate) fn subject(&mut self, view: &TrainingView<T>) -> Option<Var> {
        let lives = self.model.find(SEED_LIVES).filter(|_| self.has_silhouette(view))?;
        let lives = self.tape.value(lives).as_slice().as_chunks::<5>().0;
        let flags: Vec<T> = lives.iter().map(|life| if is_seed(life) { T::ONE } else { T::ZERO }).collect();
        Some(self.tape.constant(Tensor::from_vec([flags.len(), 1], flags)))
    }

    /// Whether [`Step::silhouette`] applies to a view: its weight is positive and the view has a mask.
    pub(crate) fn has_silhouette(&self, view: &TrainingView<T>) -> bool {
        self.shared.has_seeds() && self.shared.seeds.silhouette > 0.0 && self.supplements.moving(view.index).is_some()
    }

    /// The mean |weight − mask| over the pixels of a view, where the weights [H, W, 1] are those of the subject's
    /// Gaussians.
    pub(crate) fn silhouette(&mut self, weights: Var, view: &TrainingView<T>) {
        let Some(moving) = self.supplements.moving(view.index) else { return };
        let mask = self.constants.get(self.tape.device(), "silhouette", view.index, || mask_image(moving));
        let mask = self.tape.constant(mask);
        let value = l1(self.tape, weights, mask);
        self.add_loss(SILHOUETTE.name, self.shared.seeds.silhouette / self.views.len() as f64, value);
    }
}

//! The Gaussians of a moving subject beside those that anchors spawn, with the effect `seed-from-masks`: they are stored
//! one by one, because the networks of an anchor would have to learn the colours of every seed.

use shaders::arrays::rows::concat_rows;
use shaders::rasteriser::projection::joined;
use shaders::tape::{Real, Tape, Tensor, Var};

use super::{GaussianDeformation, SpawnedGaussians};
use crate::bases::gaussians::{GAUSSIANS, static_splats};
use crate::bases::static_mask;
use crate::data::TrainingView;
use crate::method::{Moment, SEED_LIVES, Step};
use crate::model::Variables;

impl GaussianDeformation {
    /// The Gaussians of a moment: those that anchors have spawned, followed by the subject's, if the model has seeds.
    /// The field moves both.
    pub(crate) fn all_at<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        moment: &Moment<'_>,
        spawned: SpawnedGaussians,
    ) -> SpawnedGaussians {
        let splats = self.deform(tape, model, moment.scene, spawned.splats, moment.time);
        if model.find(SEED_LIVES).is_none() {
            return SpawnedGaussians { splats, ..spawned };
        }
        // The colours of anchors do not depend on the viewing direction except through their networks.
        let stored = static_splats(tape, model, GAUSSIANS, 0);
        let subject = static_mask::move_some(tape, model, moment, stored, |tape, subject, _| {
            self.deform(tape, model, moment.scene, subject, moment.time)
        });
        let subject_count = tape.value(subject.positions).rows();
        SpawnedGaussians { splats: joined(tape, &splats, &subject), subject_count, ..spawned }
    }
}

impl SpawnedGaussians {
    /// [M, 1]: 1 for the Gaussians of the subject, otherwise 0; `None` as for [`Step::subject`].
    pub(super) fn subject<T: Real>(&self, step: &mut Step<'_, T>, view: &TrainingView<T>) -> Option<Var> {
        let of_subject = step.subject(view)?;
        let others = step.tape.value(self.splats.positions).rows() - self.subject_count;
        let others = step.tape.constant(Tensor::zeros([others, 1]));
        Some(concat_rows(step.tape, &[others, of_subject]))
    }
}

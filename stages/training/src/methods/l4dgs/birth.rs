//! Initial semantic features of seeds: the teacher's output for the frame that a seed comes from.
//!
//! A seed is shown for a few frames only, so the losses hardly move its features away from their first values.

use glam::DVec2;
use scene::{LabelMap, pixels};
use shaders::tape::{Device, Real, Tape, Tensor};

use super::tokens::TokenGrid;
use super::{LanguageGuided, SEMANTICS, lesson};
use crate::bases::gaussians::GAUSSIANS;
use crate::bases::seeds::born_at;
use crate::data::{LoadedView, mask_image};
use crate::method::{SEED_LIVES, Start};
use crate::model::ModelState;

/// Minimum share of moving pixels of a token that mostly shows the subject.
const MOSTLY: f64 = 0.5;

/// The teacher's answer to a frame, at the tokens that show the subject.
struct Answer<T: Real> {
    /// [tokens, features] of unit length, of all tokens.
    features: Tensor<T>,
    /// Centre in pixels and row of every token that mostly shows the subject, because tokens on its edge also encode
    /// the background. If there are none, the tokens with the largest share of the subject.
    subject: Vec<([f64; 2], usize)>,
}

impl LanguageGuided {
    /// Gives every seed the features of the nearest token that mostly shows the subject, in the first view of its time that
    /// shows the seed.
    pub(super) fn insert_seed_semantics<T: Real>(
        &self,
        state: &mut ModelState<T>,
        start: &Start<'_>,
    ) -> anyhow::Result<()> {
        let Ok(lives) = state.get(SEED_LIVES) else { return Ok(()) };
        let positions = state.get(&format!("{GAUSSIANS}.positions"))?;
        let mut semantics = state.get(SEMANTICS)?.clone();
        let width = semantics.row_len();
        let mut is_known = vec![false; semantics.rows()];
        for view in &start.dataset.train {
            let Some(moving) = start.supplements.moving(view.index) else { continue };
            let shown = |row: usize| Some((row, subject_pixel(view, moving, positions.row(row))?));
            let born: Vec<_> = born_at(lives, view.time).filter(|&row| !is_known[row]).filter_map(shown).collect();
            if born.is_empty() {
                continue;
            }
            let answer = self.answer_at_birth(state, start, view);
            for (row, place) in born {
                semantics.make_mut()[row * width..(row + 1) * width].copy_from_slice(answer.nearest(place));
                is_known[row] = true;
            }
        }
        state.insert(SEMANTICS, semantics);
        Ok(())
    }

    fn answer_at_birth<T: Real>(&self, state: &ModelState<T>, start: &Start<'_>, view: &LoadedView) -> Answer<T> {
        let (height, width) = (view.camera.height, view.camera.width);
        let grid = TokenGrid::of_image(height, width, &self.settings.teacher);
        let mut tape = Tape::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| false);
        let image = tape.constant(view.image());
        let visual_tokens = lesson::tokens_of(start.supplements, grid, view.index).map(|tokens| tape.constant(tokens));
        let observed = self.teacher().observe(&mut tape, &model, grid, image, visual_tokens);
        let mask = start.supplements.moving(view.index).expect("the frame of a seed has a mask");
        let mask = tape.constant(mask_image(mask));
        let shares = grid.pool(&mut tape, mask);
        let shares = tape.value(shares).as_slice();
        let most = shares.iter().map(|share| share.to_f64()).fold(0.0, f64::max).min(MOSTLY);
        let size = [width as f64 / grid.columns as f64, height as f64 / grid.rows as f64];
        let center = |token: usize| {
            let cell = [token % grid.columns, token / grid.columns];
            [0, 1].map(|axis| (cell[axis] as f64 + 0.5) * size[axis])
        };
        let subject = (0..shares.len()).filter(|&token| shares[token].to_f64() >= most);
        Answer {
            features: tape.value(observed.features).clone(),
            subject: subject.map(|token| (center(token), token)).collect(),
        }
    }
}

impl<T: Real> Answer<T> {
    /// The features of the token of the subject that is nearest to a place in pixels.
    fn nearest(&self, place: [f64; 2]) -> &[T] {
        let distance = |center: [f64; 2]| (center[0] - place[0]).hypot(center[1] - place[1]);
        let nearest = self.subject.iter().min_by(|(a, _), (b, _)| distance(*a).total_cmp(&distance(*b)));
        self.features.row(nearest.expect("some token has the largest share").1)
    }
}

/// Where a view shows a world position, right and down in pixels; `None` if no moving pixel shows it.
fn subject_pixel<T: Real>(view: &LoadedView, moving: &LabelMap, position_world: &[T]) -> Option<[f64; 2]> {
    let [right, down, depth] = view.camera.project([0, 1, 2].map(|axis| position_world[axis].to_f64()));
    let at = pixels::index_at(DVec2::new(right, down), moving.width, moving.height)?;
    (depth > 0.0 && moving.labels[at] != 0).then_some([right, down])
}

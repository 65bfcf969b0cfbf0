//! Semantic and depth losses (equations 3 to 10) at one instant and on changes between two.

mod due;
mod observed;
mod terms;
mod weights;

use shaders::arrays::rows::{columns, concat_columns, reshape, scale_rows};
use shaders::arrays::totals::total;
use shaders::pointwise::{mul, square, sub};
use shaders::rasteriser::{Rendered, SplatVars};
use shaders::tape::{Real, Tape, Tensor, Var};

use super::teacher::Teacher;
use super::tokens::TokenGrid;
use super::{LanguageGuided, SEMANTICS, lesson};
use crate::bases::gaussians::GAUSSIANS;
use crate::clock::LOSSES;
use crate::data::{TrainingView, reduced_camera};
use crate::method::{Method as _, Observed, Step, photometric_losses};
use due::{DEPTH_SPREAD, Due};
use observed::{RenderedTokens, color_statistics, depth_cells, depth_unit, rendered_tokens};
use terms::{Term, add_angle, add_distance};
use weights::{CellMask, focus, normalized, still};

/// Minimum length of semantic features, or of their changes, for a cosine; the targets are unit vectors, so shorter
/// ones carry no direction.
const MIN_FEATURE_NORM: f64 = 1e-2;
/// Minimum norm of a token's centred depths, in [`depth_unit`], for a cosine; the relief is flat below it.
const MIN_RELIEF_NORM: f64 = 1e-4;

/// Names of cached outputs of the teacher (features, attention) for frames that it read with their visual tokens.
const GIVEN: [&str; 2] = ["teacher's features", "teacher's attention"];
/// Names of cached outputs of the teacher for frames whose visual tokens were withheld.
const WITHHELD: [&str; 2] = ["teacher's features without tokens", "teacher's attention without tokens"];

/// Names of cached targets of depth: values and mask.
const DEPTH: [&str; 2] = ["depth of cells", "cells with depth"];

/// The frozen teacher's output for a frame.
struct Answer {
    /// [tokens, features]: SMSA, of unit length.
    features: Var,
    /// [tokens, 1]: the attention that every token receives.
    focus: Var,
}

impl LanguageGuided {
    /// The photometric loss, and the semantic losses in steps that evaluate them.
    pub(super) fn image_losses<T: Real>(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        let Some(due) = self.due(step) else { return photometric_losses(self, step) };
        for view in step.views {
            self.view_losses(step, view, &due)?;
        }
        Ok(())
    }

    /// The teacher's training loss: decodes every token of the frame. Every other iteration withholds the visual
    /// tokens, so that the teacher also works on renders, which have none.
    pub(super) fn teacher_losses<T: Real>(&self, step: &mut Step<'_, T>) {
        let share = 1.0 / step.views.len() as f64;
        for view in step.views {
            step.clock.enter("teacher");
            let grid = self.grid(view);
            let visual_tokens = lesson::visual_tokens(step, grid, view.index);
            let given = visual_tokens.filter(|_| !step.iteration.is_multiple_of(2));
            let image = step.tape.constant(view.image.clone());
            let output = self.teacher().observe(step.tape, step.model, grid, image, given);
            let statistics = color_statistics(step.tape, grid, image);
            let weights = lesson::weights(step, grid, view, &self.settings.teacher);
            step.clock.enter(LOSSES);
            let losses = Teacher::reconstruction(
                step.tape,
                step.model,
                output.features,
                statistics,
                visual_tokens.filter(|_| Teacher::reads_visual_tokens(step.model)),
                weights,
            );
            for (weight, value) in losses {
                step.add_loss("reconstruction", share * weight, value);
            }
        }
    }

    fn view_losses<T: Real>(&self, step: &mut Step<'_, T>, view: &TrainingView<T>, due: &Due) -> anyhow::Result<()> {
        let grid = self.grid(view);
        let rendered = self.photometric_and_tokens(step, view, due, grid)?;
        step.clock.enter("tokens");
        let tokens = rendered_tokens(step, grid, &rendered, self.settings.min_alpha);
        let covered = total(step.tape, tokens.covered);
        step.count_skipped_deferred("tokens without Gaussians", covered, grid.count());

        let needs_teacher = due.static_semantics.is_some() || self.on.attention_focus;
        let answer = needs_teacher.then(|| self.answer(step, grid, view, true));
        let focus = match &answer {
            Some(answer) if self.on.attention_focus => answer.focus,
            _ => step.tape.constant(Tensor::full([grid.count(), 1], T::ONE)),
        };
        step.clock.enter(LOSSES);
        if let (Some(term), Some(answer)) = (due.static_semantics, &answer) {
            let weights = normalized(step.tape, focus, tokens.covered);
            let features = tokens.features.expect("rendered where semantic losses are due");
            add_equation_3(step, term, [answer.features, features], weights);
        }
        if let Some(term) = due.perceptual_semantics {
            self.perceptual_semantics(step, term, view, grid, (&rendered, &tokens), focus);
        }
        if let Some(term) = due.static_depth {
            static_depth(step, term, view, grid, &tokens, focus);
        }
        if due.dynamic_depth.is_some() && step.units.unit(DEPTH_SPREAD).is_none() {
            measure_depth_spread(step, &tokens, focus);
        }
        if due.dynamics() {
            self.changes(step, due, view, grid, (&rendered, &tokens), focus)?;
        }
        Ok(())
    }

    /// Adds the photometric loss of a view, and returns the render for the losses of its tokens.
    fn photometric_and_tokens<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        view: &TrainingView<T>,
        due: &Due,
        grid: TokenGrid,
    ) -> anyhow::Result<Rendered> {
        step.clock.enter("motion");
        let splats = self.splats(step.tape, step.model, &step.moment(view))?;
        // The gradients of the semantic losses must not decide where Gaussians are cloned.
        if let Some(reduced) = reduced(view, grid) {
            step.compare(&splats, view, Observed::All(GAUSSIANS))?;
            return self.render_tokens(step, &splats, &reduced, due, None, Observed::Nothing);
        }
        // The statistics of density control are means over the observed steps, so it skips the steps whose only render
        // has these gradients, unless there are no others.
        let every_step = self.settings.interval == 1 || self.settings.dynamic_interval == 1;
        let observed = if every_step { Observed::All(GAUSSIANS) } else { Observed::Nothing };
        let subject = step.subject(view);
        let mut rendered = self.render_tokens(step, &splats, view, due, subject, observed)?;
        step.photometric(1.0, rendered.color, view);
        if let (Some(_), Some(features)) = (subject, rendered.features) {
            let [semantics, weights] = without_last(step.tape, features);
            step.silhouette(weights, view);
            rendered.features = due.semantics().then_some(semantics);
        }
        Ok(rendered)
    }

    /// Renders splats into a view with the outputs that the evaluated losses need, and the weight of the `subject` as the
    /// last feature.
    fn render_tokens<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        splats: &SplatVars,
        view: &TrainingView<T>,
        due: &Due,
        subject: Option<Var>,
        observed: Observed<'_>,
    ) -> anyhow::Result<Rendered> {
        let semantics = due.semantics().then(|| step.model.get(SEMANTICS));
        let features = match (semantics, subject) {
            (Some(semantics), Some(subject)) => Some(concat_columns(step.tape, &[semantics, subject])),
            (semantics, subject) => semantics.or(subject),
        };
        let without_depth = std::mem::replace(&mut step.raster.depth, due.depth());
        let rendered = step.render(splats, features, view, observed);
        step.raster.depth = without_depth;
        rendered
    }

    /// The other reading of equation 3: SMSA of the *render*, with its gradient into the colours, follows SMSA of the frame.
    /// Both are encoded without visual tokens, which a render does not have.
    fn perceptual_semantics<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        term: Term,
        view: &TrainingView<T>,
        grid: TokenGrid,
        (rendered, tokens): (&Rendered, &RenderedTokens),
        focus: Var,
    ) {
        let target = self.answer(step, grid, view, false).features;
        step.clock.enter(LOSSES);
        let shown = self.teacher().observe(step.tape, step.model, grid, rendered.color, None).features;
        let weights = normalized(step.tape, focus, tokens.covered);
        add_equation_3(step, term, [target, shown], weights);
    }

    /// Equations 6 to 8: changes from the view's time to one frame later, from the same camera.
    fn changes<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        due: &Due,
        view: &TrainingView<T>,
        grid: TokenGrid,
        (rendered, tokens): (&Rendered, &RenderedTokens),
        focus: Var,
    ) -> anyhow::Result<()> {
        let moves = |labels: &scene::LabelMap| labels.labels.iter().any(|&label| label != 0);
        if !step.supplements.moving(view.index).is_none_or(moves) {
            step.count_skipped("changes of frames without motion", 1, 1);
            return Ok(());
        }
        let (later, is_real) = later_view(step, view);
        step.clock.enter("motion");
        let splats = self.splats(step.tape, step.model, &step.moment(&later))?;
        let shown = reduced(&later, grid);
        let later_rendered =
            self.render_tokens(step, &splats, shown.as_ref().unwrap_or(&later), due, None, Observed::Nothing)?;
        step.clock.enter("tokens");
        let later_tokens = rendered_tokens(step, grid, &later_rendered, self.settings.min_alpha);
        step.clock.enter(LOSSES);
        if let Some(term) = due.dynamic_semantics {
            // Compares real frames if the camera is static, otherwise two renders: the difference between a frame and a
            // render would be mistaken for motion.
            let outputs = if is_real {
                let tokens_given = [view, &later].iter().all(|view| lesson::has_tokens(step, view.index));
                [view, &later].map(|view| self.answer(step, grid, view, tokens_given).features)
            } else {
                [rendered, &later_rendered].map(|rendered| {
                    let image = step.tape.detach(rendered.color);
                    self.teacher().observe(step.tape, step.model, grid, image, None).features
                })
            };
            let features = [tokens, &later_tokens].map(|tokens| tokens.features.expect("rendered"));
            let covered = mul(step.tape, tokens.covered, later_tokens.covered);
            let weights = normalized(step.tape, focus, covered);
            dynamic_semantics(step, term, outputs, features, weights);
        }
        if let Some(term) = due.dynamic_depth {
            let mask = CellMask::new(step.tape, tokens.cells_covered, later_tokens.cells_covered);
            let any = mask.any(step.tape);
            let weights = normalized(step.tape, focus, any);
            let weights = still(step.tape, weights);
            let weights = mask.per_cell(step.tape, weights);
            let depths = [&later_tokens, tokens].map(|tokens| tokens.depth.expect("rendered"));
            let masked = depths.map(|depth| mask.masked(step.tape, depth));
            add_distance(step, term, masked, weights);
        }
        Ok(())
    }

    /// The frozen teacher's output for a training frame, computed when it is first needed.
    fn answer<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        grid: TokenGrid,
        view: &TrainingView<T>,
        tokens_given: bool,
    ) -> Answer {
        let [features, attention] = if tokens_given { GIVEN } else { WITHHELD };
        if let Some([features, focus]) = kept(step, [features, attention], view.index) {
            return Answer { features, focus };
        }
        step.clock.enter("teacher");
        let visual_tokens = lesson::visual_tokens(step, grid, view.index).filter(|_| tokens_given);
        let image = step.tape.constant(view.image.clone());
        let output = self.teacher().observe(step.tape, step.model, grid, image, visual_tokens);
        let focus = focus(step.tape, output.probabilities);
        keep(step, [features, attention], view.index, [output.features, focus]);
        step.clock.enter(LOSSES);
        Answer { features: output.features, focus }
    }

    fn grid<T: Real>(&self, view: &TrainingView<T>) -> TokenGrid {
        TokenGrid::of_image(view.camera.height, view.camera.width, &self.settings.teacher)
    }
}

/// Equation 3: Σ w·(‖SMSA − F‖² + λ·(1 − cos(SMSA, F))) of target and found features over the covered tokens.
fn add_equation_3<T: Real>(step: &mut Step<'_, T>, term: Term, features: [Var; 2], weights: Var) {
    add_distance(step, term, features, weights);
    add_angle(step, term, features, weights, MIN_FEATURE_NORM);
}

/// Equation 4 on the vector of a token's n cell depths: Σ w·(‖D − D*‖²/n + λ·(1 − cos(D − mean D, D* − mean D*))) over
/// cells that Gaussians cover and that have a depth.
fn static_depth<T: Real>(
    step: &mut Step<'_, T>,
    term: Term,
    view: &TrainingView<T>,
    grid: TokenGrid,
    tokens: &RenderedTokens,
    focus: Var,
) {
    let Some([target, known]) = depth_target(step, view, grid) else {
        return step.count_skipped("depth of frames without depth", 1, 1);
    };
    let mask = CellMask::new(step.tape, tokens.cells_covered, known);
    let any = mask.any(step.tape);
    let weights = normalized(step.tape, focus, any);
    let depth = tokens.depth.expect("rendered where depth losses are due");
    let masked = [target, depth].map(|depth| mask.masked(step.tape, depth));
    let per_cell = mask.per_cell(step.tape, weights);
    add_distance(step, term, masked, per_cell);
    let centered = masked.map(|depth| mask.centered(step.tape, depth));
    add_angle(step, term, centered, weights, MIN_RELIEF_NORM);
}

/// Measures the unit of depth: changes of depth have no gradient until something moves, but the depths differ from the start.
fn measure_depth_spread<T: Real>(step: &mut Step<'_, T>, tokens: &RenderedTokens, focus: Var) {
    let mask = CellMask::new(step.tape, tokens.cells_covered, tokens.cells_covered);
    let any = mask.any(step.tape);
    let weights = normalized(step.tape, focus, any);
    let per_cell = mask.per_cell(step.tape, weights);
    let depth = tokens.depth.expect("rendered where depth losses are due");
    let masked = mask.masked(step.tape, depth);
    let weighted = scale_rows(step.tape, masked, per_cell);
    let mean = total(step.tape, weighted);
    let squared_mean = square(step.tape, mean);
    let squares = mul(step.tape, weighted, masked);
    let mean_of_squares = total(step.tape, squares);
    let views = step.views.len() as f64;
    step.measure_unit(DEPTH_SPREAD, 1.0 / views, mean_of_squares);
    step.measure_unit(DEPTH_SPREAD, -1.0 / views, squared_mean);
}

/// Equation 7: Σ w·(λ_D·(1 − cos(δSMSA, δF)) + ‖δSMSA‖² + ‖δF‖²). ‖δSMSA‖² has no gradient; it is included for
/// reporting.
fn dynamic_semantics<T: Real>(step: &mut Step<'_, T>, term: Term, outputs: [Var; 2], features: [Var; 2], weights: Var) {
    let changes = [outputs, features].map(|[now, later]| sub(step.tape, later, now));
    add_angle(step, term, changes, weights, MIN_FEATURE_NORM);
    add_distance(step, term, [outputs[1], outputs[0]], weights);
    let weights = still(step.tape, weights);
    add_distance(step, term, [features[1], features[0]], weights);
}

/// Two cached tensors of a view as constants; `None` unless an earlier step kept both.
fn kept<T: Real>(step: &mut Step<'_, T>, names: [&'static str; 2], view: usize) -> Option<[Var; 2]> {
    let [Some(a), Some(b)] = names.map(|name| step.constants.kept(name, view)) else { return None };
    Some([a, b].map(|tensor| step.tape.constant(tensor)))
}

/// Keeps tensors of a view for later steps.
fn keep<T: Real>(step: &Step<'_, T>, names: [&'static str; 2], view: usize, vars: [Var; 2]) {
    names.into_iter().zip(vars).for_each(|(name, var)| step.constants.keep(name, view, step.tape.value(var)));
}

/// The view's imported depth per cell and a mask of the cells that have it, both [tokens, CELLS²], if there is any depth.
fn depth_target<T: Real>(step: &mut Step<'_, T>, view: &TrainingView<T>, grid: TokenGrid) -> Option<[Var; 2]> {
    let prior = step.supplements.view(view.index)?.depth.as_ref()?;
    if let Some(target) = kept(step, DEPTH, view.index) {
        return Some(target);
    }
    // Depth of the static scene is that behind a moving subject.
    let hidden = step.supplements.moving(view.index).filter(|_| step.supplements.depth_is_static);
    let cells = depth_cells(grid, prior, hidden, depth_unit(step));
    let target = cells.map(|cells| step.tape.constant(cells));
    keep(step, DEPTH, view.index, target);
    Some(target)
}

/// The view at a reduced size, whose image must not be used; `None` if its tokens need all pixels. Values of tokens and
/// cells are means over pixels, so most pixels of a large render would cost time and change nothing.
fn reduced<T: Real>(view: &TrainingView<T>, grid: TokenGrid) -> Option<TrainingView<T>> {
    let reduction = grid.reduction(view.camera.height, view.camera.width);
    (reduction > 1).then(|| TrainingView { camera: reduced_camera(&view.camera, reduction), ..view.clone() })
}

/// The channels [H, W, C] of an image without the last one, and the last one.
fn without_last<T: Real>(tape: &mut Tape<T>, image: Var) -> [Var; 2] {
    let &[height, width, channels] = tape.value(image).shape() else { unreachable!("features are [H, W, C]") };
    let pixels = reshape(tape, image, [height * width, channels]);
    [0..channels - 1, channels - 1..channels].map(|range| {
        let count = range.len();
        let part = columns(tape, pixels, range);
        reshape(tape, part, [height, width, count])
    })
}

/// The next training frame of the same camera pose, if there is one within 1.5 frame intervals (true). Otherwise a copy
/// of the view one interval later (earlier at the end of the clip), whose image must not be used (false).
fn later_view<T: Real>(step: &Step<'_, T>, view: &TrainingView<T>) -> (TrainingView<T>, bool) {
    let frame = step.scene.training_interval();
    // The tolerance of half a frame allows for irregular times.
    let next = |time: f64| time > view.time && time <= view.time + 1.5 * frame;
    let real = step.dataset.train.iter().filter(|other| other.camera == view.camera && next(other.time));
    match real.min_by(|a, b| a.time.total_cmp(&b.time)) {
        Some(found) => (found.to_training(), true),
        None => {
            let later = view.time + frame;
            let time = if later <= 1.0 { later } else { (view.time - frame).max(0.0) };
            (TrainingView { time, ..view.clone() }, false)
        }
    }
}

//! The teacher's targets for a frame: its visual tokens at unit length, and the weight of every token.
//!
//! Tokens that show only the background's colour have weight 0. If frames have visual tokens and prompts, all prompts
//! have equal weight: otherwise the teacher would mostly learn the background, which most tokens show.

use shaders::arrays::rows::normalize;
use shaders::tape::{Device, Real, Tape, Tensor, Var};

use super::settings::TeacherSettings;
use super::teacher::TEXT;
use super::tokens::TokenGrid;
use crate::data::{FeatureTokens, Supplements, TrainingView};
use crate::method::Step;

/// The largest difference from the background's colour, per channel, of an empty pixel: the rounding of resized 8-bit
/// images.
const BACKGROUND_MARGIN: f64 = 1.5 / 255.0;
/// Maximum weight of a prompt's tokens, relative to equally weighted tokens: it limits the weight of rare prompts,
/// because otherwise one frame could dominate the training.
const MAX_BALANCE: f64 = 10.0;
/// Lower bound of the norm of a token.
const MIN_NORM: f64 = 1e-6;

/// Whether a view has imported visual tokens.
pub(super) fn has_tokens<T: Real>(step: &Step<'_, T>, view: usize) -> bool {
    imported(step.supplements.features.as_ref(), view).is_some()
}

/// The imported visual tokens of a view, [tokens, F] of unit length.
pub(super) fn visual_tokens<T: Real>(step: &mut Step<'_, T>, grid: TokenGrid, view: usize) -> Option<Var> {
    const KEPT: &str = "visual tokens";
    if let Some(kept) = step.constants.kept(KEPT, view) {
        return Some(step.tape.constant(kept));
    }
    let tokens = step.tape.constant(tokens_of(step.supplements, grid, view)?);
    step.constants.keep(KEPT, view, step.tape.value(tokens));
    Some(tokens)
}

/// [tokens, F] of unit length: the imported visual tokens of a view.
pub(super) fn tokens_of<T: Real>(supplements: &Supplements, grid: TokenGrid, view: usize) -> Option<Tensor<T>> {
    Some(unit_tokens(grid, imported(supplements.features.as_ref(), view)?))
}

/// [tokens, 1]: the weights of a frame's tokens in the teacher's loss. Their sum is 1 on average over the frames.
pub(super) fn weights<T: Real>(
    step: &mut Step<'_, T>,
    grid: TokenGrid,
    view: &TrainingView<T>,
    settings: &TeacherSettings,
) -> Var {
    const KEPT: &str = "lesson";
    if let Some(kept) = step.constants.kept(KEPT, view.index) {
        return step.tape.constant(kept);
    }
    let image = step.dataset.training_view(view.index).image::<f64>();
    let shown = shown(grid, &image, step.scene.background);
    let uniform = 1.0 / grid.count() as f64;
    let of_tokens = match (balance(step, settings), language(step)) {
        (Some(balance), Some(features)) if has_tokens(step, view.index) => {
            let tokens = imported(Some(features), view.index).expect("it has tokens");
            classes(&unit_tokens(grid, tokens), &features.text.cast()).into_iter().map(|class| balance[class]).collect()
        }
        _ => vec![uniform; grid.count()],
    };
    let weights = of_tokens.iter().zip(shown).map(|(weight, shown)| T::from_f64(weight * shown)).collect();
    let weights = step.tape.constant(Tensor::from_vec([grid.count(), 1], weights));
    step.constants.keep(KEPT, view.index, step.tape.value(weights));
    weights
}

/// The imported features, if the model reads their prompts.
fn language<'a, T: Real>(step: &Step<'a, T>) -> Option<&'a FeatureTokens> {
    step.model.find(TEXT)?;
    step.supplements.features.as_ref().filter(|features| features.text.rows() > 0)
}

/// [P]: the weight of a token that shows a prompt, so that all prompts have the same total weight over the training
/// frames; none without imported prompts.
fn balance<T: Real>(step: &Step<'_, T>, settings: &TeacherSettings) -> Option<Vec<f64>> {
    const KEPT: &str = "balance";
    let features = language(step)?;
    // Rounded alike whether they were kept or not: a resumed training has not kept them yet.
    let rounded = |weights: &Tensor<T>| weights.as_slice().iter().map(|weight| weight.to_f64()).collect();
    if let Some(kept) = step.constants.kept(KEPT, 0) {
        return Some(rounded(&kept));
    }
    let text = features.text.cast();
    let (mut counts, mut frames) = (vec![0.0; text.rows()], 0.0);
    for view in &step.dataset.train {
        let Some(tokens) = imported(Some(features), view.index) else { continue };
        let grid = TokenGrid::of_image(view.camera.height, view.camera.width, settings);
        let shown = shown(grid, &view.image(), step.scene.background);
        let classes = classes(&unit_tokens(grid, tokens), &text);
        classes.into_iter().zip(shown).for_each(|(class, shown)| counts[class] += shown);
        frames += 1.0;
    }
    let weights = balanced(&counts, frames).into_iter().map(T::from_f64).collect();
    let weights = Tensor::from_vec([text.rows()], weights);
    step.constants.keep(KEPT, 0, &weights);
    Some(rounded(&weights))
}

/// The weight of a token per class, given the number of its tokens in all frames together.
fn balanced(counts: &[f64], frames: f64) -> Vec<f64> {
    let total: f64 = counts.iter().sum();
    let seen = counts.iter().filter(|&&count| count > 0.0).count().max(1) as f64;
    let weight = |&count: &f64| {
        let relative = if count > 0.0 { total / (seen * count) } else { 0.0 };
        relative.min(MAX_BALANCE) * frames / total.max(1.0)
    };
    counts.iter().map(weight).collect()
}

fn imported(features: Option<&FeatureTokens>, view: usize) -> Option<&Tensor<f32>> {
    features?.visual.get(view)?.as_ref()
}

/// Visual tokens [rows, columns, F] on the grid of the teacher, [tokens, F] of unit length.
fn unit_tokens<T: Real>(grid: TokenGrid, tokens: &Tensor<f32>) -> Tensor<T> {
    let mut tape = Tape::new(Device::Cpu);
    let tokens = tape.constant(tokens.cast());
    let pooled = grid.pool(&mut tape, tokens);
    let unit = normalize(&mut tape, pooled, MIN_NORM);
    tape.value(unit).clone()
}

/// The share of every token's pixels that do not have the background's colour.
fn shown(grid: TokenGrid, image: &Tensor<f64>, background: [f32; 3]) -> Vec<f64> {
    let &[height, width, _] = image.shape() else { panic!("an image is [H, W, 3]") };
    let differs = |(&value, background): (&f64, f32)| (value - f64::from(background)).abs() > BACKGROUND_MARGIN;
    let is_shown = |pixel: &[f64]| f64::from(u8::from(pixel.iter().zip(background).any(differs)));
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let mask = Tensor::from_vec([height, width, 1], image.as_slice().chunks_exact(3).map(is_shown).collect());
    let mask = tape.constant(mask);
    let shares = grid.pool(&mut tape, mask);
    tape.value(shares).as_slice().to_vec()
}

/// The prompt that is nearest to each token, by the angle.
fn classes(tokens: &Tensor<f64>, text: &Tensor<f64>) -> Vec<usize> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let prompts: Vec<&[f64]> = (0..text.rows()).map(|prompt| text.row(prompt)).collect();
    let lengths: Vec<f64> = prompts.iter().map(|prompt| dot(prompt, prompt).sqrt().max(MIN_NORM)).collect();
    let nearest = |token: usize| {
        let cosine = |prompt: usize| dot(tokens.row(token), prompts[prompt]) / lengths[prompt];
        (0..prompts.len()).max_by(|&a, &b| cosine(a).total_cmp(&cosine(b))).unwrap_or(0)
    };
    (0..tokens.rows()).map(nearest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_prompt_has_the_same_total_weight_up_to_a_limit() {
        let counts = [900.0, 60.0, 40.0, 0.0];
        let weights = balanced(&counts, 10.0);
        let totals: Vec<f64> = counts.iter().zip(&weights).map(|(count, weight)| count * weight).collect();
        // The sum is the number of frames; nothing shows the last prompt.
        assert!(totals[..3].iter().all(|total| (total - 10.0 / 3.0).abs() < 1e-9) && weights[3] == 0.0, "{totals:?}");
        let rare = balanced(&[999.0, 1.0], 1.0);
        assert!((rare[1] - MAX_BALANCE / 1000.0).abs() < 1e-12, "{rare:?}");
    }

    #[test]
    fn tokens_that_show_only_the_background_do_not_count() {
        // Two tokens of two pixels: half a token shows something, the other one nothing.
        let image = [[0.2, 0.2, 0.2], [0.9, 0.2, 0.2], [0.2, 0.2, 0.2], [0.2, 0.203, 0.2]].concat();
        let image = Tensor::from_vec([1, 4, 3], image);
        assert_eq!(shown(TokenGrid { rows: 1, columns: 2 }, &image, [0.2; 3]), [0.5, 0.0]);
    }

    #[test]
    fn a_token_belongs_to_the_prompt_with_the_nearest_direction() {
        let text = Tensor::from_vec([2, 2], vec![100.0, 0.0, 0.0, 1.0]);
        let tokens = Tensor::from_vec([3, 2], vec![0.6, 0.8, 1.0, 0.0, 0.8, 0.6]);
        assert_eq!(classes(&tokens, &text), [1, 0, 0]);
    }
}

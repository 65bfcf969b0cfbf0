//! The expected work of trainings and of renders of their models.

use captures::{pixels_per_view, view_count};
use engine::{Facts, PlanContext, Work};
use scene::Split;

use super::{COARSE, GAUSSIANS, METHOD, START};
use crate::effects::CAPTURE;
use crate::params::TrainingParams;
use crate::schedule::stretch;

/// Pixels that cost about as much to draw as one Gaussian costs to move and project. The engine learns the ratio of each
/// method from measured jobs; this is where it begins.
const PIXELS_PER_GAUSSIAN: f64 = 4.0;

/// The work of a training: iterations × views per iteration × (pixels, Gaussians). Unknown for a training with a budget,
/// which chooses its own length, and for a capture of unknown size.
pub(crate) fn training_work(params: &TrainingParams, context: &PlanContext<'_>) -> Option<Work> {
    let shared = &params.shared;
    if shared.budget_secs.is_some() {
        return None;
    }
    let pixels = pixels_per_view(context.facts(CAPTURE)?)?;
    // A training that continues from a shared phase does not repeat it.
    let done = context.facts(START).and_then(|facts| facts.value(COARSE)?["phase"].as_str());
    let phases = shared.iterations.iter().filter(|(phase, _)| match &shared.stop_after {
        Some(last) => *phase == last,
        None => done != Some(phase),
    });
    let steps: u64 = phases.map(|(_, steps)| stretch(*steps, shared.schedule_scale)).sum();
    let views = steps as f64 * shared.batch as f64;
    let part = shared.stop_after.as_deref().or(done.map(|_| "rest")).unwrap_or("whole");
    let amounts = [views * pixels, views * PIXELS_PER_GAUSSIAN * gaussians(params)];
    Work::of_both(format!("{} {part}", params.method), amounts)
}

/// The work of rendering the views of a split from a model with these facts: views × (pixels, Gaussians).
pub fn model_work(model: &Facts, capture: &Facts, split: Split) -> Option<Work> {
    let (pixels, views) = (pixels_per_view(capture)?, view_count(capture, split)?);
    let gaussians = model.value(GAUSSIANS)?.as_f64()?;
    let amounts = [views * pixels, views * PIXELS_PER_GAUSSIAN * gaussians];
    Work::of_both(model.value(METHOD)?.as_str()?, amounts)
}

/// The expected number of Gaussians: between the first points, which density control prunes and clones, and its limit.
pub(super) fn gaussians(params: &TrainingParams) -> f64 {
    let most = params.shared.density.max_count.max(1) as f64;
    let first = (params.shared.initial_points.random_count.max(1) as f64).min(most);
    (first * most).sqrt()
}

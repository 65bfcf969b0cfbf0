//! The expected work of trainings and of renders of their models.

use captures::{pixels_per_view, view_count};
use engine::{Facts, PlanContext, Work};
use scene::Split;

use super::{GAUSSIANS, METHOD, SHARED_PHASE, START};
use crate::effects::CAPTURE;
use crate::params::TrainingParams;
use crate::schedule::stretch;
use crate::shared::{CoarseToFine, Density};

/// Pixels that cost about as much to draw as one Gaussian costs to move and project. The engine learns the ratio of each
/// method from measured jobs; this is its initial value.
const PIXELS_PER_GAUSSIAN: f64 = 4.0;
/// Growth of the number of Gaussians in one round of density control: from 589 after two rounds to more than 5,984 after
/// ten (`static3dgs` in `recipes/quickstart.toml`, with `schedule_scale` 0.02 and 0.07).
const GROWTH_PER_ROUND: f64 = 1.25;
/// The number of Gaussians at which density control often settles: 16,000 to 33,000 for `deformable4dgs` on D-NeRF at 800×800.
const PLATEAU: f64 = 30_000.0;
/// The number of moments of a training over which the number of Gaussians is averaged.
const MOMENTS: u64 = 64;

/// The work of a training: iterations × views per iteration × (pixels, Gaussians). Unknown for a training with a budget,
/// which chooses its own length, and for a capture of unknown size.
pub(crate) fn training_work(params: &TrainingParams, context: &PlanContext<'_>) -> Option<Work> {
    let shared = &params.shared;
    if shared.budget_secs.is_some() {
        return None;
    }
    let pixels = pixels_per_view(context.facts(CAPTURE)?)?;
    // A training that continues from a shared phase does not repeat the phases up to its end.
    let start = context.facts(START).and_then(|facts| facts.value(SHARED_PHASE));
    let is_done = |phase: &str| start.is_some_and(|recipe| recipe["iterations"].get(phase).is_some());
    let steps = steps(params, |phase| !is_done(phase))?;
    let views = steps as f64 * shared.batch as f64;
    let pixels = pixels * shared.resolution_schedule().map_or(1.0, CoarseToFine::mean_pixel_share);
    let after = start.map(|recipe| format!("after {}", recipe["phase"].as_str().unwrap_or_default()));
    let part = shared.stop_after.clone().or(after).unwrap_or_else(|| "whole".into());
    let amounts = [views * pixels, views * PIXELS_PER_GAUSSIAN * mean_gaussians(params, steps)];
    Work::of_both(format!("{} {part}", params.method), amounts)
}

/// The work of rendering the views of a split from a model with these facts: views × (pixels, Gaussians).
pub fn model_work(model: &Facts, capture: &Facts, split: Split) -> Option<Work> {
    let (pixels, views) = (pixels_per_view(capture)?, view_count(capture, split)?);
    let gaussians = model.value(GAUSSIANS)?.as_f64()?;
    let amounts = [views * pixels, views * PIXELS_PER_GAUSSIAN * gaussians];
    Work::of_both(model.value(METHOD)?.as_str()?, amounts)
}

/// The number of Gaussians that a training is expected to end with.
pub(super) fn gaussians(params: &TrainingParams) -> f64 {
    gaussians_at(params, steps(params, |_| true).unwrap_or(0))
}

/// The expected number of Gaussians after this many steps. Every round of density control lets them grow by about the
/// same factor, up to a plateau.
fn gaussians_at(params: &TrainingParams, steps: u64) -> f64 {
    let Density { from, until, interval, max_count, .. } = params.shared.density;
    let [from, until] = [from, until].map(|step| stretch(step, params.shared.schedule_scale));
    let rounds = steps.min(until).saturating_sub(from) / interval.max(1);
    let most = max_count.max(1) as f64;
    let first = (params.shared.initial_points.random_count.max(1) as f64).min(most);
    (first * GROWTH_PER_ROUND.powf(rounds as f64)).min(first.max(PLATEAU)).min(most)
}

/// The expected mean number of Gaussians over a training of `steps` steps.
fn mean_gaussians(params: &TrainingParams, steps: u64) -> f64 {
    let moments = (0..MOMENTS).map(|moment| steps * (2 * moment + 1) / (2 * MOMENTS));
    moments.map(|step| gaussians_at(params, step)).sum::<f64>() / MOMENTS as f64
}

/// The steps of those phases of the job that count; `None` for parameters that no job can have.
fn steps(params: &TrainingParams, counts: impl Fn(&str) -> bool) -> Option<u64> {
    let phases = params.phases_to_run(&*params.build().ok()?).ok()?;
    Some(phases.iter().filter(|phase| counts(phase.name)).map(|phase| phase.iterations).sum())
}

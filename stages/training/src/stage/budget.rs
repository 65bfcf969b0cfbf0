//! Training to a deadline: the affordable length of the schedule is measured, then the training is an ordinary one.
//!
//! The cost of a step depends on the machine, and it changes as Gaussians multiply and phases follow each other. The
//! whole training is therefore first run in miniature, with every schedule shortened by a `schedule_scale`: once very
//! short, once in about a tenth of the budget. The slope between the two is the cost of a unit of scale, including all
//! phases and density control; costs that do not depend on the length cancel out.
//!
//! The resulting scale depends on the clock. It is therefore chosen once, before the first step, stored next to the
//! checkpoints, and reported in the model's parameters (`schedule_scale`) and in the measurements. A training with a
//! budget is not reproducible bit for bit; the same training with that `schedule_scale` and no budget is, and its model
//! differs only in the recorded parameters. The budget refers to the training clock: evaluation and the miniatures are
//! not included. The training is never cut short: if the machine slows down, a training takes longer than its budget,
//! and `training_secs` shows it.

use std::path::Path;
use std::sync::atomic::Ordering;

use anyhow::Context as _;
use engine::{Failure, FailureKind, Progress};
use serde::{Deserialize, Serialize};

use super::watch::Watch;
use crate::data::{Dataset, Supplements};
use crate::params::TrainingParams;
use crate::trainer::{Trainer, UNCLOCKED};

/// File name of the choice, in the folder of the checkpoints.
const FILE: &str = "budget.json";
/// Steps of the first miniature over all phases: enough to amortise first touches of memory.
const FIRST_STEPS: f64 = 40.0;
/// Share of the budget that the second miniature takes.
const SECOND_SHARE: f64 = 0.1;
/// Minimum ratio of the lengths of the two miniatures, so that their difference determines a slope.
const LEAST_RATIO: f64 = 3.0;
/// Share of the budget that is planned; the rest is a margin, because longer trainings have more Gaussians.
const PLANNED_SHARE: f64 = 0.9;
/// Ratio of a training's time to its budget above which a warning is given.
const MUCH_LONGER: f64 = 1.5;
/// Maximum scale: the method's own schedule.
const LONGEST_SCALE: f64 = 1.0;

/// The scale chosen for a budget, and the measurements behind it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Choice {
    /// The budget: seconds of training.
    pub budget_secs: f64,
    /// The chosen factor of every schedule.
    pub schedule_scale: f64,
    /// Measured seconds of training per unit of `schedule_scale`.
    pub secs_per_scale: f64,
    /// Measured seconds of training that do not depend on the scale.
    pub fixed_secs: f64,
    /// Seconds spent on the miniatures, which are not training.
    pub calibration_secs: f64,
}

/// The parameters to train with: those given, with a schedule that fits the budget if there is one. `None` if the job
/// was stopped meanwhile.
pub(super) fn fit(
    dataset: &Dataset,
    supplements: &Supplements,
    params: &TrainingParams,
    watch: &Watch<'_>,
) -> anyhow::Result<Option<(TrainingParams, Option<Choice>)>> {
    let Some(budget_secs) = params.shared.budget_secs else { return Ok(Some((params.clone(), None))) };
    let path = watch.checkpoint_dir.join(FILE);
    let earlier = std::fs::read(&path).ok().and_then(|bytes| serde_json::from_slice::<Choice>(&bytes).ok());
    let choice = match earlier.filter(|choice| choice.budget_secs == budget_secs) {
        Some(choice) => choice,
        None => {
            let mut run = |scale| {
                let message = format!("training a miniature for the budget: schedule_scale {scale:.2e}");
                (watch.on_progress)(Progress { done: 0, total: 0, message });
                miniature(dataset, supplements, params, scale, watch)
            };
            let steps = steps_of(dataset, supplements, &with_scale(params, 1.0))?;
            let Some(choice) = choose(budget_secs, steps, &mut run)? else { return Ok(None) };
            keep(&choice, &path)?;
            choice
        }
    };
    tracing::info!(
        "a budget of {budget_secs} s gives schedule_scale = {}; set that scale without a budget to reproduce the result",
        choice.schedule_scale
    );
    Ok(Some((with_scale(params, choice.schedule_scale), Some(choice))))
}

impl Choice {
    /// Warns if a training took much longer than its budget. The miniatures of a short budget end before density control has
    /// added most of the Gaussians, so their iterations are too fast.
    pub(super) fn warn_if_exceeded(&self, training_secs: f64) {
        let Self { budget_secs, schedule_scale, .. } = self;
        if training_secs > MUCH_LONGER * budget_secs {
            tracing::warn!(
                "the training took {training_secs:.0} s instead of the budget of {budget_secs} s; for a shorter one, set \
                 schedule_scale below {schedule_scale:.3} instead of a budget"
            );
        }
    }
}

/// The cost of a training at some scale, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Cost {
    /// Time on the training clock.
    training: f64,
    /// Total time.
    wall: f64,
}

/// Chooses the scale for a budget from the costs that `run` returns for two scales; `steps` is the length of a training
/// of scale 1. `None` if `run` was stopped.
fn choose(
    budget_secs: f64,
    steps: u64,
    run: &mut dyn FnMut(f64) -> anyhow::Result<Option<Cost>>,
) -> anyhow::Result<Option<Choice>> {
    let first_scale = (FIRST_STEPS / steps.max(1) as f64).min(LONGEST_SCALE);
    let Some(first) = run(first_scale)? else { return Ok(None) };
    let mut calibration_secs = first.wall;
    let (mut secs_per_scale, mut fixed_secs) = (first.training / first_scale, 0.0);
    let affordable_scale = SECOND_SHARE * budget_secs / secs_per_scale;
    let second_scale = affordable_scale.max(LEAST_RATIO * first_scale).min(LONGEST_SCALE);
    if second_scale > first_scale && first.training <= budget_secs {
        let Some(second) = run(second_scale)? else { return Ok(None) };
        calibration_secs += second.wall;
        let slope = (second.training - first.training) / (second_scale - first_scale);
        // The slope is not positive if the machine was busy during the first miniature only.
        secs_per_scale = if slope > 0.0 { slope } else { second.training / second_scale };
        fixed_secs = (second.training - secs_per_scale * second_scale).max(0.0);
    }
    let affordable_scale = (PLANNED_SHARE * budget_secs - fixed_secs) / secs_per_scale;
    // This condition is also true for NaN.
    if !(affordable_scale >= first_scale) {
        let message = format!("a budget of {budget_secs} s is too short for {FIRST_STEPS} steps");
        let hint = format!("give at least {:.0} s", (first.training / PLANNED_SHARE).ceil());
        return Err(Failure::new(FailureKind::BadInput, message).hint(hint).into());
    }
    let schedule_scale = affordable_scale.min(LONGEST_SCALE);
    Ok(Some(Choice { budget_secs, schedule_scale, secs_per_scale, fixed_secs, calibration_secs }))
}

/// Runs a whole training at a scale, without the curve; `None` if it was stopped.
fn miniature(
    dataset: &Dataset,
    supplements: &Supplements,
    params: &TrainingParams,
    scale: f64,
    watch: &Watch<'_>,
) -> anyhow::Result<Option<Cost>> {
    let mut params = with_scale(params, scale);
    params.shared.curve.points = 0;
    let mut trainer = Trainer::new(dataset, supplements, &params)?.on(watch.device);
    while !trainer.is_done() {
        trainer.advance()?;
        if watch.stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
    }
    let clock = trainer.report().seconds_by_phase;
    Ok(Some(Cost { training: clock.total_except(&UNCLOCKED), wall: clock.total_except(&[]) }))
}

fn steps_of(dataset: &Dataset, supplements: &Supplements, params: &TrainingParams) -> anyhow::Result<u64> {
    Ok(Trainer::new(dataset, supplements, params)?.steps().1)
}

fn with_scale(params: &TrainingParams, scale: f64) -> TrainingParams {
    let mut params = params.clone();
    params.shared.schedule_scale = scale;
    params
}

/// Writes the choice so that a resumed training makes the same one.
fn keep(choice: &Choice, path: &Path) -> anyhow::Result<()> {
    let write = || -> anyhow::Result<()> {
        let folder = path.parent().context("the folder of the checkpoints")?;
        let mut file = tempfile::NamedTempFile::new_in(folder)?;
        serde_json::to_writer(&mut file, choice)?;
        file.persist(path)?;
        Ok(())
    };
    write().with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use serde_json::json;
    use shaders::tape::Device;

    use super::*;
    use crate::data::NOTHING;
    use crate::scene_tests::TestScene;

    /// A machine on which a training takes `fixed` + `slope` · scale seconds.
    fn machine(fixed: f64, slope: f64) -> impl FnMut(f64) -> anyhow::Result<Option<Cost>> {
        move |scale| {
            let secs = fixed + slope * scale;
            Ok(Some(Cost { training: secs, wall: secs }))
        }
    }

    #[test]
    fn the_scale_fits_the_budget() {
        for (fixed, slope, budget) in [(0.0, 900.0, 60.0), (5.0, 900.0, 60.0), (2.0, 100.0, 10.0)] {
            let choice = choose(budget, 30_000, &mut machine(fixed, slope)).unwrap().unwrap();
            let takes = fixed + slope * choice.schedule_scale;
            assert!((takes / (PLANNED_SHARE * budget) - 1.0).abs() < 1e-6, "{takes} s of {budget} s: {choice:?}");
            assert!(choice.calibration_secs < 0.2 * budget + 2.0 * fixed, "{choice:?}");
        }
    }

    #[test]
    fn long_budgets_keep_the_schedule_and_short_ones_are_refused() {
        let whole = choose(1e6, 30_000, &mut machine(1.0, 900.0)).unwrap().unwrap();
        assert_eq!(whole.schedule_scale, 1.0);
        let refused = choose(1.0, 30_000, &mut machine(3.0, 900.0)).unwrap_err().to_string();
        assert!(refused.contains("too short") && refused.contains("give at least 5 s"), "{refused}");
        assert!(choose(1.0, 30_000, &mut machine(f64::NAN, 1.0)).is_err());
        assert_eq!(choose(60.0, 30_000, &mut |_| Ok(None)).unwrap(), None);
    }

    #[test]
    fn a_resumed_training_keeps_its_choice() {
        let dir = tempfile::tempdir().unwrap();
        let dataset = Dataset::load(TestScene::default().write(&dir.path().join("capture")), 1).unwrap();
        let params = |budget_secs: f64| -> TrainingParams {
            serde_json::from_value(json!({
                "budget_secs": budget_secs, "iterations": { "train": 400 },
                "initial_points": { "random_count": 30 }, "curve": { "points": 0 },
            }))
            .unwrap()
        };
        let (go, stopped) = (AtomicBool::new(false), AtomicBool::new(true));
        let (on_progress, checkpoint_dir) = (&|_| (), dir.path());
        let watch = |stop| Watch { stop, pause_at: None, on_progress, checkpoint_dir, device: Device::Cpu };
        let fitted = |budget| fit(&dataset, &NOTHING, &params(budget), &watch(&go)).unwrap().unwrap();
        let (first, choice) = fitted(2.0);
        let choice = choice.unwrap();
        assert_eq!((first.shared.schedule_scale, first.shared.budget_secs), (choice.schedule_scale, Some(2.0)));
        assert!(choice.schedule_scale > 0.0 && choice.schedule_scale <= 1.0 && choice.calibration_secs > 0.0);
        assert_eq!(fitted(2.0), (first, Some(choice)), "chosen again");
        assert_eq!(fitted(3.0).1.unwrap().budget_secs, 3.0);
        assert!(fit(&dataset, &NOTHING, &params(4.0), &watch(&stopped)).unwrap().is_none());
        let without: TrainingParams = serde_json::from_value(json!({})).unwrap();
        assert_eq!(fit(&dataset, &NOTHING, &without, &watch(&stopped)).unwrap(), Some((without, None)));
    }
}

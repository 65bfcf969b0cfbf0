//! Predicts the time of a search from those of its jobs, and how many trials fit into the given time.

use std::collections::BTreeMap;

use engine::estimate::Estimate;

use super::{Search, now_secs, trial};
use crate::error::CliError;
use crate::output::{count, duration, note};
use crate::session::Session;

/// Trials whose jobs are predicted; more would delay the start of the search.
const SAMPLES: usize = 8;

/// The predicted jobs of some of the next trials.
#[derive(Debug, Default)]
struct Forecast {
    /// The number of trials.
    trials: usize,
    /// Plan id → predicted time, share of it that a trial computes on average, and number of trials that need the job.
    jobs: BTreeMap<String, (Estimate, f64, usize)>,
}

impl Search<'_> {
    /// Prints the predicted time of the trials that have not begun and, if the time is limited, how many fit. Prints nothing
    /// if no comparable job was measured.
    pub(super) fn print_forecast(&self) -> Result<(), CliError> {
        let begun = self.history.points.len();
        let next = begun..self.trials;
        let left = next.len();
        let mut forecast = Forecast::default();
        for point in next.take(SAMPLES).map_while(|number| self.sampler.point(number, &[])) {
            if !self.predict(&point, &mut forecast)? {
                return Ok(());
            }
        }
        let is_alone = self.args.workers.is_none() && self.args.devices.is_empty();
        let time = (self.end_secs - now_secs()).max(0.0);
        if let Some(text) = forecast.text(left, Some(time).filter(|time| is_alone && time.is_finite())) {
            note(&text);
        }
        Ok(())
    }

    /// Adds the jobs of a trial at this point; returns `false` if the time of any is unknown.
    fn predict(&self, point: &[f64], forecast: &mut Forecast) -> Result<bool, CliError> {
        let mut session = match Session::read_only(self.store, &self.recipe_at(point)) {
            // An invalid trial takes no time.
            Err(CliError::Recipe(_)) => return Ok(true),
            session => session?,
        };
        let trained = trial::trainings(&session.plan).collect();
        session.targets = trained;
        forecast.trials += 1;
        for (index, prediction) in session.predict()?.into_iter().filter(|(_, prediction)| prediction.may_run()) {
            let Some(estimate) = prediction.estimate else { return Ok(false) };
            let share = if session.targets.contains(&index) { self.halving.mean_share() } else { 1.0 };
            let id = session.plan.nodes[index].plan_id.clone();
            forecast.jobs.entry(id).or_insert((estimate, share, 0)).2 += 1;
        }
        Ok(true)
    }
}

impl Forecast {
    /// `40 trials: about 12 min of training (8 min to 20 min), predicted from …`; `None` without a job.
    fn text(&self, left: usize, time: Option<f64>) -> Option<String> {
        let all = || self.jobs.values().map(|(estimate, ..)| estimate);
        let measurements = all().map(|one| one.measurements).max()?;
        // Jobs that all trials share run once.
        let is_common = |needed: usize| self.trials > 1 && needed == self.trials;
        let secs = |is_wanted: &dyn Fn(usize) -> bool| -> f64 {
            let jobs = self.jobs.values().filter(|(_, _, needed)| is_wanted(*needed));
            jobs.map(|(estimate, share, _)| estimate.secs * share).sum()
        };
        let (common, each) = (secs(&is_common), secs(&|needed| !is_common(needed)) / self.trials as f64);
        let total = common + left as f64 * each;
        // The errors of trials are correlated, so they do not cancel.
        let sum: f64 = all().map(|one| one.secs).sum();
        let ends = [0, 1].map(|end| duration(total * all().map(|one| one.range_secs[end]).sum::<f64>() / sum));
        let elsewhere = if all().any(|one| one.is_foreign) { " of other machines" } else { "" };
        let fitting = time.map(|time| {
            let number = ((time - common) / each).max(0.0).min(left as f64) as usize;
            format!("; about {number} fit into {}", duration(time))
        });
        Some(format!(
            "{}: about {} of training ({} to {}), predicted from up to {}{elsewhere}{}",
            count(left, "trial"),
            duration(total),
            ends[0],
            ends[1],
            count(measurements, "measurement"),
            fitting.unwrap_or_default()
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shared_jobs_count_once_and_trials_fit_into_the_rest() {
        let estimate = |secs: f64| Estimate {
            secs,
            range_secs: [0.5 * secs, 2.0 * secs],
            measurements: 3,
            has_same_job: false,
            is_foreign: false,
        };
        let jobs = [("capture", 20.0, 1.0, 2), ("train a", 200.0, 0.5, 1), ("train b", 400.0, 0.5, 1)];
        let jobs = jobs.map(|(id, secs, share, needed)| (id.to_owned(), (estimate(secs), share, needed)));
        let forecast = Forecast { trials: 2, jobs: jobs.into() };
        // 20 s once, and 150 s for each trial.
        let expected = "10 trials: about 25 min 20 s of training (12 min 40 s to 50 min 40 s), predicted from up to \
                        3 measurements; about 3 fit into 9 min 0 s";
        assert_eq!(forecast.text(10, Some(540.0)).unwrap(), expected);
        assert!(forecast.text(10, Some(1e9)).unwrap().contains("about 10 fit"));
        assert!(forecast.text(10, Some(10.0)).unwrap().contains("about 0 fit"));
        assert!(Forecast::default().text(10, None).is_none());
    }
}

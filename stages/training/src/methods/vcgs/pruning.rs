//! Removes surfels that contribute little. No surfels are ever added.

use anyhow::Context as _;

use super::settings::Pruning;
use crate::bases::gaussians::{RADIUS_PX, Statistics, logit};
use crate::method::{AfterStep, ScreenStats, StepHook};
use crate::schedule::stretch;

/// Prunes one layer by opacity and by size on the screen.
#[derive(Clone)]
pub(crate) struct SurfelPruning {
    population: &'static str,
    params: Pruning,
    /// Statistics since the last round.
    statistics: Statistics,
}

impl SurfelPruning {
    pub(crate) fn new(population: &'static str, params: &Pruning, schedule_scale: f64) -> Self {
        let params = Pruning { interval: stretch(params.interval, schedule_scale), ..params.clone() };
        Self { population, params, statistics: Statistics::default() }
    }

    /// Mask of the rows to keep; if too few would remain, the most opaque rows of all are kept.
    pub(super) fn survivors(&self, opacity_logits: &[f32]) -> Vec<bool> {
        let (min_logit, max_radius) = (logit(self.params.min_opacity) as f32, self.params.max_radius_px as f32);
        let rows = self.statistics.rows();
        let is_large = |row: usize| rows.get(row).is_some_and(|row| row[RADIUS_PX] > max_radius);
        let stays = |(row, &logit): (usize, &f32)| logit >= min_logit && !is_large(row);
        let mut keep: Vec<bool> = opacity_logits.iter().enumerate().map(stays).collect();
        if keep.iter().filter(|&&keep| keep).count() < self.params.min_count {
            let mut by_opacity: Vec<usize> = (0..opacity_logits.len()).collect();
            by_opacity.sort_by(|&a, &b| opacity_logits[b].total_cmp(&opacity_logits[a]).then(a.cmp(&b)));
            keep.fill(false);
            by_opacity.into_iter().take(self.params.min_count).for_each(|row| keep[row] = true);
        }
        keep
    }
}

impl StepHook for SurfelPruning {
    fn observes_at(&self, _iteration: u64) -> bool {
        true
    }

    fn observe(&mut self, stats: &ScreenStats<'_>) {
        if stats.population == self.population {
            self.statistics.observe(stats);
        }
    }

    fn reads_rows_at(&self, iteration: u64) -> bool {
        iteration > self.params.interval && iteration.is_multiple_of(self.params.interval)
    }

    fn after_step(&mut self, AfterStep { iteration, optimizer, .. }: AfterStep<'_>) -> anyhow::Result<()> {
        if self.reads_rows_at(iteration) {
            let keep = self.survivors(optimizer.tensor(&format!("{}.opacity_logits", self.population))?.as_slice());
            optimizer.keep(self.population, &keep)?;
            self.statistics = Statistics::default();
        }
        Ok(())
    }

    fn save(&self) -> serde_json::Value {
        serde_json::to_value(&self.statistics).expect("numbers serialise")
    }

    fn restore(&mut self, saved: serde_json::Value) -> anyhow::Result<()> {
        self.statistics = serde_json::from_value(saved).context("the pruning statistics of the checkpoint")?;
        Ok(())
    }
}

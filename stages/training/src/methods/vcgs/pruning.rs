//! Removes surfels that nobody misses; none are ever added.

use anyhow::Context as _;
use rand_chacha::ChaCha8Rng;

use super::settings::Pruning;
use crate::bases::gaussians::logit;
use crate::method::{PopulationControl, SceneFacts};
use crate::optimizer::Optimizer;
use crate::schedule::stretch;
use crate::screen::Screen;

/// Prunes one layer by opacity and by size on the screen.
#[derive(Clone)]
pub struct SurfelPruning {
    population: &'static str,
    params: Pruning,
    /// Since the last round.
    radius_px: Vec<f32>,
}

impl SurfelPruning {
    pub fn new(population: &'static str, params: &Pruning, schedule_scale: f64) -> Self {
        let params = Pruning { interval: stretch(params.interval, schedule_scale), ..params.clone() };
        Self { population, params, radius_px: Vec::new() }
    }

    /// Which rows stay; where too few would, the most opaque of all.
    pub(super) fn survivors(&self, opacity_logits: &[f32]) -> Vec<bool> {
        let (min_logit, max_radius) = (logit(self.params.min_opacity) as f32, self.params.max_radius_px as f32);
        let is_large = |row: usize| self.radius_px.get(row).is_some_and(|&radius| radius > max_radius);
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

impl PopulationControl for SurfelPruning {
    fn watches(&self, _iteration: u64) -> bool {
        true
    }

    fn observe(&mut self, screen: &Screen<'_>) {
        if screen.population != self.population {
            return;
        }
        let radius_px = &screen.on_host().radius_px;
        self.radius_px.resize(radius_px.len(), 0.0);
        self.radius_px.iter_mut().zip(radius_px).for_each(|(total, &radius)| *total = total.max(radius));
    }

    fn judges(&self, iteration: u64) -> bool {
        iteration > self.params.interval && iteration.is_multiple_of(self.params.interval)
    }

    fn act(
        &mut self,
        iteration: u64,
        optimizer: &mut Optimizer,
        _scene: &SceneFacts,
        _random: &mut ChaCha8Rng,
    ) -> anyhow::Result<()> {
        if self.judges(iteration) {
            let keep = self.survivors(optimizer.tensor(&format!("{}.opacity_logits", self.population))?.as_slice());
            optimizer.keep(self.population, &keep)?;
            self.radius_px.clear();
        }
        Ok(())
    }

    fn boxed_clone(&self) -> Box<dyn PopulationControl> {
        Box::new(self.clone())
    }

    fn save(&self) -> serde_json::Value {
        serde_json::to_value(&self.radius_px).expect("numbers serialise")
    }

    fn restore(&mut self, saved: serde_json::Value) -> anyhow::Result<()> {
        self.radius_px = serde_json::from_value(saved).context("the pruning statistics of the checkpoint")?;
        Ok(())
    }
}

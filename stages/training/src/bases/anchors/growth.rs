//! Growing and pruning of anchors (Lu et al. 2024, section 3.3, with the constants of the published code).
//!
//! Growing adds anchors at Gaussians whose projected means have a large gradient, level by level: the larger the
//! gradient, the smaller the cell that must be free of anchors. Pruning removes anchors whose Gaussians stayed
//! transparent.

mod statistics;

use std::collections::{BTreeMap, BTreeSet};

use anyhow::Context as _;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use serde::Deserialize as _;

use super::initial::{cell, center};
use super::{ANCHORS, AnchorSettings, Growth};
use crate::bases::collapse::CollapseGuard;
use crate::method::{AfterStep, ScreenStats, StepHook};
use crate::model::Optimizer;
use crate::schedule::stretch;
use crate::shared::Density;
use statistics::Statistics;

/// Cells shrink by this factor from level to level, and their gradient threshold doubles.
const CELL_SHRINK: f64 = 4.0;
/// A Gaussian needs this share of the observations that an anchor needs.
const SEEN_SHARE: f64 = 0.5;

/// Grows and prunes anchors.
#[derive(Clone)]
pub(crate) struct AnchorGrowth {
    density: Density,
    growth: Growth,
    voxel_size: f64,
    per_anchor: usize,
    starts_at_zero: &'static [&'static str],
    statistics: Statistics,
    guard: CollapseGuard,
}

/// A cell that becomes an anchor.
struct Candidate {
    /// The anchors of the Gaussians in the cell.
    parents: Vec<usize>,
    /// The largest gradient of those Gaussians.
    gradient: f32,
}

impl AnchorGrowth {
    /// Growth of [`ANCHORS`], with a schedule stretched by `schedule_scale` and voxels in units of `unit_world`.
    pub(crate) fn new(density: &Density, settings: &AnchorSettings, schedule_scale: f64, unit_world: f64) -> Self {
        let density = Density {
            from: stretch(density.from, schedule_scale),
            until: stretch(density.until, schedule_scale),
            ..density.clone()
        };
        let statistics_from = stretch(settings.growth.statistics_from, schedule_scale);
        let growth = Growth { statistics_from, ..settings.growth.clone() };
        Self {
            density,
            growth,
            voxel_size: settings.voxel_size * unit_world,
            per_anchor: settings.offsets,
            starts_at_zero: &["offsets"],
            statistics: Statistics::default(),
            guard: CollapseGuard::default(),
        }
    }

    /// Growth whose new anchors have zeros in these attributes, as far as the model has them.
    pub(crate) fn with_zeros(self, starts_at_zero: &'static [&'static str]) -> Self {
        Self { starts_at_zero, ..self }
    }

    /// An anchor may be pruned if it was in view in more than this number of steps; a Gaussian may add an anchor if it
    /// was visible in more than [`SEEN_SHARE`] of it.
    fn views_needed(&self) -> f64 {
        self.density.interval as f64 * self.growth.success
    }

    fn grow(&mut self, optimizer: &mut Optimizer, random: &mut ChaCha8Rng) -> anyhow::Result<()> {
        let gradients = self.statistics.mean_gradients(SEEN_SHARE * self.views_needed());
        let places = gaussian_positions(optimizer)?;
        for level in 0..self.growth.levels {
            let cell_size = self.voxel_size * self.growth.largest_cell / CELL_SHRINK.powi(level as i32);
            let threshold = self.density.gradient_threshold as f32 * 2_f32.powi(level as i32);
            // Half of the candidates are skipped on the first level, a quarter on the second, …
            let passing = 1.0 - 0.5_f64.powi(level as i32 + 1);
            let passes = |(slot, gradient): (usize, &Option<f32>)| {
                let gradient = (*gradient).filter(|gradient| *gradient >= threshold)?;
                (random.random::<f64>() < passing).then_some((slot, gradient))
            };
            let candidates: Vec<(usize, f32)> = gradients.iter().enumerate().filter_map(passes).collect();
            let free = self.free_cells(optimizer, &candidates, &places, cell_size)?;
            add_anchors(optimizer, free, cell_size, self.starts_at_zero)?;
        }
        self.statistics.reset_gradients(SEEN_SHARE * self.views_needed());
        self.statistics.resize(optimizer.population_len(ANCHORS)?);
        Ok(())
    }

    /// The cells of the candidate Gaussians (slot, gradient) that hold no anchor. If they would exceed the cap on
    /// anchors, those with the largest gradients.
    fn free_cells(
        &self,
        optimizer: &Optimizer,
        candidates: &[(usize, f32)],
        places: &[[f32; 3]],
        cell_size: f64,
    ) -> anyhow::Result<Vec<([i64; 3], Candidate)>> {
        let anchors = optimizer.tensor(&format!("{ANCHORS}.positions"))?.as_slice().as_chunks::<3>().0;
        let taken: BTreeSet<[i64; 3]> = anchors.iter().map(|&position| cell(position, cell_size)).collect();
        let per_anchor = self.per_anchor;
        let mut free: BTreeMap<[i64; 3], Candidate> = BTreeMap::new();
        for &(slot, gradient) in candidates {
            let cell = cell(places[slot], cell_size);
            if taken.contains(&cell) {
                continue;
            }
            let candidate = free.entry(cell).or_insert(Candidate { parents: Vec::new(), gradient });
            candidate.parents.push(slot / per_anchor);
            candidate.gradient = candidate.gradient.max(gradient);
        }
        let capacity = self.density.max_count.saturating_sub(anchors.len());
        let mut free: Vec<_> = free.into_iter().collect();
        if free.len() > capacity {
            free.sort_by(|(_, a), (_, b)| b.gradient.total_cmp(&a.gradient));
            free.truncate(capacity);
        }
        Ok(free)
    }

    /// Removes anchors that were in view often enough and whose Gaussians were transparent. The most opaque anchor
    /// always stays. A round that would empty the model removes none, ends all pruning, and returns a notice; networks
    /// predict the opacities, so none is restored.
    fn prune(&mut self, optimizer: &mut Optimizer, iteration: u64) -> anyhow::Result<Option<String>> {
        let opacities = self.statistics.mean_opacities(self.views_needed());
        let opacity = |anchor: usize| opacities[anchor].unwrap_or(1.0);
        let most_opaque = (0..opacities.len()).map(opacity).fold(0.0, f32::max);
        let min_opacity = most_opaque.min(self.density.min_opacity as f32);
        let keep: Vec<bool> = (0..opacities.len()).map(|anchor| opacity(anchor) >= min_opacity).collect();
        if let Some(notice) = self.guard.refuses(ANCHORS, iteration, &keep) {
            return Ok(Some(notice));
        }
        optimizer.keep(ANCHORS, &keep)?;
        self.statistics.reset_opacities(self.views_needed());
        self.statistics.keep(&keep);
        Ok(None)
    }
}

/// Appends an anchor at the centre of every free cell: a copy of its first parent, with the maximum of every feature
/// over all parents, zeros in the attributes `starts_at_zero`, and scales equal to the side of the cell.
fn add_anchors(
    optimizer: &mut Optimizer,
    free: Vec<([i64; 3], Candidate)>,
    cell_size: f64,
    starts_at_zero: &[&str],
) -> anyhow::Result<()> {
    let first_new = optimizer.population_len(ANCHORS)?;
    let first_parents: Vec<usize> = free.iter().map(|(_, candidate)| candidate.parents[0]).collect();
    optimizer.append_copies(ANCHORS, &first_parents)?;
    let name = |attribute: &str| format!("{ANCHORS}.{attribute}");
    optimizer.edit(&name("positions"), |positions| {
        let new = positions[3 * first_new..].as_chunks_mut::<3>().0;
        new.iter_mut().zip(&free).for_each(|(position, (cell, _))| *position = center(*cell, cell_size));
    })?;
    let columns = optimizer.tensor(&name("features"))?.row_len();
    optimizer.edit(&name("features"), |features| {
        let (old, new) = features.split_at_mut(first_new * columns);
        for (feature, (_, candidate)) in new.chunks_exact_mut(columns).zip(&free) {
            for parent in &candidate.parents {
                let of_parent = &old[parent * columns..(parent + 1) * columns];
                feature.iter_mut().zip(of_parent).for_each(|(value, &other)| *value = value.max(other));
            }
        }
    })?;
    for attribute in starts_at_zero {
        // Attributes of motion exist only once it begins.
        let Ok(tensor) = optimizer.tensor(&name(attribute)) else { continue };
        let old = first_new * tensor.row_len();
        optimizer.edit(&name(attribute), |values| values[old..].fill(0.0))?;
    }
    optimizer.edit(&name("log_scales"), |scales| scales[6 * first_new..].fill(cell_size.ln() as f32))
}

/// Canonical positions of the N·K Gaussians.
fn gaussian_positions(optimizer: &Optimizer) -> anyhow::Result<Vec<[f32; 3]>> {
    let tensor = |attribute: &str| optimizer.tensor(&format!("{ANCHORS}.{attribute}"));
    let (positions, offsets, log_scales) = (tensor("positions")?, tensor("offsets")?, tensor("log_scales")?);
    let of_anchor = |anchor: usize| {
        let (position, scales) = (positions.row(anchor), log_scales.row(anchor));
        let place = |offset: &[f32; 3]| std::array::from_fn(|axis| position[axis] + offset[axis] * scales[axis].exp());
        offsets.row(anchor).as_chunks::<3>().0.iter().map(place).collect::<Vec<_>>()
    };
    Ok((0..positions.rows()).flat_map(of_anchor).collect())
}

impl StepHook for AnchorGrowth {
    fn observes_at(&self, iteration: u64) -> bool {
        iteration > self.growth.statistics_from && iteration < self.density.until
    }

    fn observe(&mut self, stats: &ScreenStats<'_>) {
        if stats.population == ANCHORS {
            self.statistics.observe(stats, self.per_anchor);
        }
    }

    fn reads_rows_at(&self, iteration: u64) -> bool {
        let Density { interval, from, .. } = self.density;
        self.observes_at(iteration) && iteration > from && iteration.is_multiple_of(interval)
    }

    fn after_step(&mut self, step: AfterStep<'_>) -> anyhow::Result<()> {
        let AfterStep { iteration, optimizer, random, notices, .. } = step;
        if !self.observes_at(iteration) {
            self.statistics = Statistics::default();
        }
        if self.reads_rows_at(iteration) && !self.statistics.is_empty() {
            self.grow(optimizer, random.of("grow"))?;
            if !self.guard.is_closed() {
                notices.extend(self.prune(optimizer, iteration)?);
            }
        }
        Ok(())
    }

    fn save(&self) -> serde_json::Value {
        serde_json::json!({ "statistics": self.statistics, "guard": self.guard })
    }

    fn restore(&mut self, saved: serde_json::Value) -> anyhow::Result<()> {
        let context = "the statistics of anchors in the checkpoint";
        self.statistics = Statistics::deserialize(&saved["statistics"]).context(context)?;
        self.guard = CollapseGuard::deserialize(&saved["guard"]).context(context)?;
        Ok(())
    }
}

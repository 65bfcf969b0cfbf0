//! The particles among the anchors and their neighbours. Canonical anchor positions are not trained, so both are
//! computed on the host and cached until anchors are added or removed.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use shaders::arrays::rows::RowIndex;
use shaders::tape::{Real, Tape, Tensor};

use super::neighbors::{Pairs, Search};
use crate::model::Variables;

/// [N, 1]: 1 for particles, 0 for static anchors; absent if all anchors are particles.
pub(crate) const DYNAMIC: &str = "anchors.dynamic";

/// The particles among N anchors.
pub(crate) struct Population<T: Real> {
    /// Canonical anchor positions [N, 3], and the mask of particles.
    positions: Tensor<T>,
    dynamic: Option<Tensor<T>>,
    /// Anchor rows of the P particles.
    pub rows: RowIndex,
    /// Neighbour pairs per search method, computed on first use.
    pairs: [OnceLock<Option<Pairs>>; Search::COUNT],
}

impl<T: Real> Population<T> {
    fn new(positions: Tensor<T>, dynamic: Option<Tensor<T>>) -> Self {
        let count = positions.rows();
        let is_particle =
            |row: &u32| dynamic.as_ref().is_none_or(|flags| flags.as_slice()[*row as usize] > T::from_f64(0.5));
        let rows = RowIndex::new((0..count as u32).filter(is_particle).collect(), count);
        Self { positions, dynamic, rows, pairs: Default::default() }
    }

    fn is_of(&self, positions: &Tensor<T>, dynamic: Option<&Tensor<T>>) -> bool {
        let same_flags = match (&self.dynamic, dynamic) {
            (Some(before), Some(now)) => before.is_same(now),
            (before, now) => before.is_none() && now.is_none(),
        };
        same_flags && self.positions.is_same(positions)
    }

    /// Pairs of neighbouring particles, with cells of this side along a curve; `None` if there are none.
    pub(crate) fn pairs(&self, search: Search, cell_size: f64) -> Option<&Pairs> {
        let find = || Pairs::new(&search.pairs(&self.canonical(), cell_size), self.rows.len());
        self.pairs[search as usize].get_or_init(find).as_ref()
    }

    /// Canonical particle positions [P, 3], world.
    fn canonical(&self) -> Vec<[f32; 3]> {
        let position = |&row: &u32| [0, 1, 2].map(|axis| self.positions.row(row as usize)[axis].to_f64() as f32);
        self.rows.row_of_item().iter().map(position).collect()
    }
}

/// Cache of the latest population.
pub(crate) struct LatestPopulation<T: Real>(Mutex<Option<Arc<Population<T>>>>);

impl<T: Real> Default for LatestPopulation<T> {
    fn default() -> Self {
        Self(Mutex::new(None))
    }
}

impl<T: Real> LatestPopulation<T> {
    /// The population of a model; cached as long as the model's tensors are unchanged.
    pub(crate) fn of(&self, tape: &Tape<T>, model: &Variables) -> Arc<Population<T>> {
        let positions = tape.value(model.get("anchors.positions"));
        let dynamic = model.find(DYNAMIC).map(|var| tape.value(var));
        let mut latest = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match &*latest {
            Some(known) if known.is_of(positions, dynamic) => known.clone(),
            _ => latest.insert(Arc::new(Population::new(positions.clone(), dynamic.cloned()))).clone(),
        }
    }
}

use std::ops::Range;

use super::{Grid, TILE};
use crate::tape::Real;

/// Relative and absolute growth of the cutoff: a thousand times the rounding of σ in f32, invisible in the lists' lengths.
const CUTOFF_SLACK: f64 = 1e-4;
/// Growth of an interval relative to its coordinates: ten roundings of an f32.
const COORDINATE_SLACK: f64 = 1e-6;

/// The set σ ≤ cutoff with σ = ½(A(dx + k·dy)² + m·dy²), slightly enlarged.
pub(crate) struct Ellipse<T> {
    center: [T; 2],
    /// A, k, m.
    conic: [T; 3],
    /// 2·cutoff.
    squared_radius: T,
    half_extents: [T; 2],
    /// y offset of the rightmost point from the centre, px; y points down.
    tip_offset: T,
}

impl<T: Real> Ellipse<T> {
    pub(super) fn new(center: [T; 2], conic: [T; 3], cutoff: T) -> Self {
        let slack = T::from_f64(CUTOFF_SLACK);
        let squared_radius = T::from_f64(2.0) * (cutoff + cutoff * slack + slack);
        let [a, k, m] = conic;
        // The covariance from the conic: var y = 1/m, var x = 1/A + k²/m, cov = −k/m.
        let (variance_x, variance_y) = (T::ONE / a + k * k / m, T::ONE / m);
        let half_extents = [(squared_radius * variance_x).sqrt(), (squared_radius * variance_y).sqrt()];
        let tip_offset = -k * variance_y / variance_x * half_extents[0];
        Self { center, conic, squared_radius, half_extents, tip_offset }
    }

    /// Half the width and height of the bounding box, in px.
    #[cfg(test)]
    pub(crate) fn half_extents(&self) -> [T; 2] {
        self.half_extents
    }

    /// The tiles that meet the ellipse: per row of tiles, a range of columns.
    pub(crate) fn tile_spans(&self, grid: Grid) -> impl Iterator<Item = (usize, Range<usize>)> {
        self.box_span(1, grid.height).map(move |row| (row, self.columns(row, grid)))
    }

    /// An upper bound of the number of tiles that meet the ellipse.
    pub(crate) fn box_tiles(&self, grid: Grid) -> u64 {
        self.box_span(0, grid.width).len() as u64 * self.box_span(1, grid.height).len() as u64
    }

    /// The tiles along one axis whose pixel centres meet the bounding box.
    fn box_span(&self, axis: usize, size: usize) -> Range<usize> {
        let (center, extent) = (self.center[axis], self.half_extents[axis]);
        let slack = T::from_f64(COORDINATE_SLACK) * (center.abs() + extent);
        tiles_between(center - extent - slack, center + extent + slack, size)
    }

    /// The columns of the tiles in a row of tiles that meet the ellipse.
    ///
    /// The part of the ellipse between the first and the last line of pixel centres is convex, so its projection onto
    /// the x axis decides. The projection ends at the tips of the ellipse or, if they lie outside, at the nearer line.
    fn columns(&self, row: usize, grid: Grid) -> Range<usize> {
        let center_of = |pixel: usize| T::from_f64(pixel as f64 + 0.5);
        let (first, last) = (row * TILE, (row * TILE + TILE).min(grid.height) - 1);
        let lowest = (center_of(first) - self.center[1]).max(-self.half_extents[1]);
        let highest = (center_of(last) - self.center[1]).min(self.half_extents[1]);
        if !(lowest <= highest) {
            return 0..0;
        }
        let right = self.edges(self.tip_offset.max(lowest).min(highest))[1];
        let left = self.edges((-self.tip_offset).max(lowest).min(highest))[0];
        let slack = T::from_f64(COORDINATE_SLACK) * (self.center[0].abs() + self.half_extents[0]);
        tiles_between(self.center[0] + left - slack, self.center[0] + right + slack, grid.width)
    }

    /// Left and right edge, relative to the centre, at a height relative to the centre.
    fn edges(&self, offset_y: T) -> [T; 2] {
        let [a, k, m] = self.conic;
        let half = ((self.squared_radius - m * offset_y * offset_y).max(T::ZERO) / a).sqrt();
        [-k * offset_y - half, -k * offset_y + half]
    }
}

/// The tiles along an axis of `size` pixels with a span of pixel centres that meets [low, high].
fn tiles_between<T: Real>(low: T, high: T, size: usize) -> Range<usize> {
    let last_center = T::from_f64(size as f64 - 0.5);
    if !(high >= T::from_f64(0.5) && low <= last_center) {
        return 0..0;
    }
    // Clamp as floats before converting to integers: coordinates are unbounded. From here on, truncation equals floor.
    let tile = T::from_f64(TILE as f64);
    let low = low.max(T::ZERO);
    let containing_low = (low / tile).to_f64() as usize;
    let is_past_its_centers = low > T::from_f64((containing_low * TILE + TILE) as f64 - 0.5);
    let containing_high = ((high.min(last_center) - T::from_f64(0.5)) / tile).to_f64() as usize;
    containing_low + usize::from(is_past_its_centers)..containing_high + 1
}

//! The constants of the scales of a field.

use crate::gpu::uniforms;
use crate::networks::hexplane::lookup::Lookup;
use crate::networks::hexplane::{Field, PAIRS, TIME};
use crate::tape::Real;

uniforms! {
    pub(crate) struct ScaleItem as "Item" {
        resolution: [u32; 4],
        cell_starts: [[u32; 4]; 2],
        points: u32,
        channels: u32,
        features: u32,
        number: u32,
        time_low: u32,
        time_high: u32,
        time_fraction: f32,
        adds: u32,
    }
}

/// The constants of every scale of a field, for this many points.
pub(super) fn scales<T: Real>(field: &Field<T>, points: usize) -> Vec<ScaleItem> {
    let (channels, mut cells) = (field.channels(), 0);
    let scale = |scale: usize| {
        let resolution = field.resolution(scale);
        let time = Lookup::new(field.time.to_f64() as f32, resolution[TIME]);
        let along = |axis: usize| resolution[axis].max(2) - 1;
        let mut cell_starts = [0; 8];
        for (plane, (a, b)) in PAIRS.into_iter().enumerate() {
            cell_starts[plane] = cells as u32;
            cells += along(a) * if b == TIME { 1 } else { along(b) };
        }
        cell_starts[6] = cells as u32;
        ScaleItem {
            resolution: resolution.map(|texels| texels as u32),
            cell_starts: [0, 4].map(|first| std::array::from_fn(|plane| cell_starts[first + plane])),
            points: points as u32,
            channels: channels as u32,
            features: (channels * field.scales()) as u32,
            number: scale as u32,
            time_low: time.low as u32,
            time_high: time.high as u32,
            time_fraction: time.fraction,
            adds: 0,
        }
    };
    (0..field.scales()).map(scale).collect()
}

/// Cells of neighbouring scales.
pub(super) fn cells(scales: &[ScaleItem]) -> usize {
    let end = scales.last().map_or(0, |scale| scale.cell_starts[1][2]);
    (end - scales.first().map_or(0, |scale| scale.cell_starts[0][0])) as usize
}

impl ScaleItem {
    pub(super) fn points(&self) -> usize {
        self.points as usize
    }

    pub(super) fn channels(&self) -> usize {
        self.channels as usize
    }

    /// The number of values that all points read from all planes of this many scales.
    pub(super) fn values(&self, scales: usize) -> usize {
        6 * scales * self.points() * self.channels()
    }
}

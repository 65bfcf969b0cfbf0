//! Splats and tiles as the fast body reads them.

use std::f32::consts::LOG2_E;

use rayon::prelude::*;

use super::{Constants, RankedSplats};
use crate::rasteriser::isa::Isa;
use crate::tape::Real;

/// One splat in the layout of the inner loop.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(super) struct Packed {
    pub mean: [f32; 2],
    /// ½A·log₂e, k, ½m·log₂e.
    pub(crate) half_a: f32,
    pub k: f32,
    pub(crate) half_m: f32,
    /// The largest s at which the splat is blended.
    pub cutoff: f32,
    pub(crate) log2_opacity: f32,
    pub color: [f32; 3],
}

/// The splats of a render, front to back.
pub(crate) struct PackedSplats<'a> {
    pub splats: Vec<Packed>,
    extras: &'a [f32],
    pub(crate) extra_count: usize,
    pub(crate) alpha_cap: f32,
    pub stop: f32,
    pub isa: Isa,
}

/// Position of a tile, the part of it inside the image, and its splats by rank.
pub(crate) struct Tile<'a> {
    pub origin: [usize; 2],
    pub extent: [usize; 2],
    pub ranks: &'a [u32],
}

impl Packed {
    fn new(&[u, v, a, k, m, opacity, cutoff, r, g, b]: &[f32; 10]) -> Self {
        Self {
            mean: [u, v],
            half_a: 0.5 * LOG2_E * a,
            k,
            half_m: 0.5 * LOG2_E * m,
            cutoff: LOG2_E * cutoff,
            log2_opacity: opacity.log2(),
            color: [r, g, b],
        }
    }
}

impl<'a> PackedSplats<'a> {
    /// `None` if the scalar type is not f32. Panics if the processor lacks the instructions.
    pub(super) fn new<T: Real>(splats: &'a RankedSplats<T>, constants: &Constants<T>, isa: Isa) -> Option<Self> {
        let records = T::as_f32(splats.records.as_flattened())?.as_chunks::<10>().0;
        assert!(isa.is_available(), "this processor has no {isa:?}");
        Some(Self {
            splats: records.par_iter().map(Packed::new).collect(),
            extras: T::as_f32(&splats.extras)?,
            extra_count: splats.extra_count,
            alpha_cap: constants.alpha_cap.to_f64() as f32,
            stop: constants.stop.to_f64() as f32,
            isa,
        })
    }

    /// Values of the extra channels of a splat.
    pub(crate) fn extras(&self, rank: u32) -> &[f32] {
        &self.extras[rank as usize * self.extra_count..][..self.extra_count]
    }
}

//! The fast body for f32: packs the splats and calls the kernel compiled for the processor's instructions.

use std::f32::consts::LOG2_E;

use rayon::prelude::*;

use super::kernel::{Plane, backward, forward};
use super::lanes::Portable;
use super::{Constants, Isa, RankedSplats};
use crate::binning::TILE;
use crate::tape::Real;

/// One splat as the inner loop wants it.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub struct Packed {
    pub mean: [f32; 2],
    /// ½A·log₂e, k, ½m·log₂e.
    pub half_a: f32,
    pub k: f32,
    pub half_m: f32,
    /// The largest s that is blended.
    pub cutoff: f32,
    pub log2_opacity: f32,
    pub color: [f32; 3],
}

/// The splats of a render, front to back.
pub struct PackedSplats<'a> {
    pub splats: Vec<Packed>,
    extras: &'a [f32],
    extra_count: usize,
    pub alpha_cap: f32,
    pub stop: f32,
    isa: Isa,
}

/// Position of a tile, the part of it inside the image, and its splats by rank.
pub struct Tile<'a> {
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
    pub fn new<T: Real>(splats: &'a RankedSplats<T>, constants: &Constants<T>, isa: Isa) -> Option<Self> {
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
    pub fn extras(&self, rank: u32) -> &[f32] {
        &self.extras[rank as usize * self.extra_count..][..self.extra_count]
    }

    /// Planes: transmittance, three colours, extras; all are written. Returns the number of blended (pixel, splat) pairs.
    pub fn forward(&self, tile: &Tile, planes: &mut [f32]) -> u64 {
        let planes = planes.as_chunks_mut::<TILE>().0.as_chunks_mut::<TILE>().0;
        match self.extra_count {
            0 => dispatch!(self.isa, forward::<false>(self, tile, planes)),
            _ => dispatch!(self.isa, forward::<true>(self, tile, planes)),
        }
    }

    /// Planes: Σ of what remains to be blended times its gradient, then the gradients of three colours and the extras; the
    /// first is overwritten. Writes one row per splat of the tile.
    pub fn backward(&self, tile: &Tile, planes: &mut [f32], rows: &mut [f32]) {
        let planes = planes.as_chunks_mut::<TILE>().0.as_chunks_mut::<TILE>().0;
        match self.extra_count {
            0 => dispatch!(self.isa, backward::<false>(self, tile, planes, rows)),
            _ => dispatch!(self.isa, backward::<true>(self, tile, planes, rows)),
        }
    }
}

/// Calls a body generic over [`Lanes`] in a function compiled for the instruction set.
macro_rules! dispatch {
    ($isa:expr, $body:ident::<$extras:literal>($($argument:expr),*)) => {
        match $isa {
            #[cfg(target_arch = "x86_64")]
            // Safety: `PackedSplats::new` has asked the processor.
            #[allow(unsafe_code)]
            Isa::Avx512 => unsafe { avx512::$body::<$extras>($($argument),*) },
            #[cfg(target_arch = "x86_64")]
            #[allow(unsafe_code)]
            Isa::Avx2 => unsafe { avx2::$body::<$extras>($($argument),*) },
            _ => $body::<Portable, $extras>($($argument),*),
        }
    };
}
use dispatch;

/// The two bodies compiled for an instruction set.
#[cfg(target_arch = "x86_64")]
macro_rules! compiled_for {
    ($module:ident, $lanes:ident, $features:literal) => {
        mod $module {
            use super::super::lanes::$lanes;
            use super::*;

            #[target_feature(enable = $features)]
            pub fn forward<const EXTRAS: bool>(splats: &PackedSplats, tile: &Tile, planes: &mut [Plane]) -> u64 {
                super::forward::<$lanes, EXTRAS>(splats, tile, planes)
            }

            #[target_feature(enable = $features)]
            pub fn backward<const EXTRAS: bool>(
                splats: &PackedSplats,
                tile: &Tile,
                planes: &mut [Plane],
                rows: &mut [f32],
            ) {
                super::backward::<$lanes, EXTRAS>(splats, tile, planes, rows)
            }
        }
    };
}
#[cfg(target_arch = "x86_64")]
compiled_for!(avx2, Avx2, "avx2,fma");
#[cfg(target_arch = "x86_64")]
compiled_for!(avx512, Avx512, "avx2,fma,avx512f,avx512bw,avx512dq,avx512vl");

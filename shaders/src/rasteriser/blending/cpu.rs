//! The fast body for f32: calls the kernel compiled for the processor's instructions.

use super::kernel::{Plane, backward, forward};
use super::lanes::Portable;
use super::packed::{PackedSplats, Tile};
use crate::rasteriser::binning::TILE;
use crate::rasteriser::isa::Isa;

impl PackedSplats<'_> {
    /// Planes: transmittance, three colours, extras; all are written. Returns the number of blended (pixel, splat) pairs.
    pub(super) fn forward(&self, tile: &Tile, planes: &mut [f32]) -> u64 {
        let planes = planes.as_chunks_mut::<TILE>().0.as_chunks_mut::<TILE>().0;
        match self.extra_count {
            0 => dispatch!(self.isa, forward::<false>(self, tile, planes)),
            _ => dispatch!(self.isa, forward::<true>(self, tile, planes)),
        }
    }

    /// Planes: Σ weight·φ of the splats behind, then the gradients of three colours and the extras; the
    /// first is overwritten. Writes one row per splat of the tile.
    pub(super) fn backward(&self, tile: &Tile, planes: &mut [f32], rows: &mut [f32]) {
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
            // Safety: `PackedSplats::new` has checked the processor.
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
            pub(super) fn forward<const EXTRAS: bool>(splats: &PackedSplats, tile: &Tile, planes: &mut [Plane]) -> u64 {
                super::forward::<$lanes, EXTRAS>(splats, tile, planes)
            }

            #[target_feature(enable = $features)]
            pub(super) fn backward<const EXTRAS: bool>(
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

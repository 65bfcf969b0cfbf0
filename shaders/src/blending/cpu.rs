//! The fast body for f32: one tile, splat by splat, a vector of pixels at a time.
//!
//! All in powers of two: s = σ·log₂e, alpha = 2^(log₂ opacity − s). A pixel that has stopped keeps its transmittance with
//! the sign flipped, so that whatever is tried on it next leaves less than the stop. Backward replays forward with the same
//! instructions, and hence with the same decisions.

use std::f32::consts::LOG2_E;

use rayon::prelude::*;

use super::lanes::{Lanes, Portable, Row};
use super::{Constants, Isa, ROW_COLORS, ROW_MOMENTS, RankedSplats};
use crate::binning::TILE;
use crate::tape::Real;

/// A value per pixel of a tile.
type Plane = [Row; TILE];

const LANE_INDEX: Row = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

/// Minimax polynomial of 2ˣ on [−½, ½] (Remez, relative error 1.6e-7 with these coefficients in f32), constant term first.
const EXP2: [f32; 6] = [1.000_000_1, 0.693_146_94, 0.240_221_2, 0.055_507_13, 0.009_675_541, 0.001_327_647_2];

/// One splat as the inner loop wants it.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub struct Packed {
    mean: [f32; 2],
    /// ½A·log₂e, k, ½m·log₂e.
    half_a: f32,
    k: f32,
    half_m: f32,
    /// The largest s that is blended.
    cutoff: f32,
    log2_opacity: f32,
    color: [f32; 3],
}

/// The splats of a render, front to back.
pub struct PackedSplats<'a> {
    splats: Vec<Packed>,
    extras: &'a [f32],
    extra_count: usize,
    alpha_cap: f32,
    stop: f32,
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

    fn extras(&self, rank: u32) -> &[f32] {
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

/// What one splat is to each row of a tile.
struct SplatRows {
    dy: Row,
    /// Where e = dx + k·dy vanishes, in pixels from the first column's centre.
    ridge: Row,
    /// ½m·dy²·log₂e.
    quad: Row,
}

impl SplatRows {
    #[inline(always)]
    fn new<V: Lanes>(splat: &Packed, tile: &Tile) -> Self {
        let mut rows = Self { dy: [0.0; TILE], ridge: [0.0; TILE], quad: [0.0; TILE] };
        let from_first = |axis: usize| splat.mean[axis] - (tile.origin[axis] as f32 + 0.5);
        let (x, y) = (V::splat(from_first(0)), V::splat(from_first(1)));
        let (k, half_m) = (V::splat(splat.k), V::splat(splat.half_m));
        for part in 0..TILE / V::WIDTH {
            let dy = y.sub(V::load(&LANE_INDEX, part));
            dy.store(&mut rows.dy, part);
            k.mul_add(dy, x).store(&mut rows.ridge, part);
            half_m.mul(dy).mul(dy).store(&mut rows.quad, part);
        }
        rows
    }

    /// A bit per row: whether any pixel of this part of the row can be within the cutoff. Rounds as the pixels do, and
    /// rounding is monotone, so that the nearest pixel decides.
    #[inline(always)]
    fn hits<V: Lanes>(&self, splat: &Packed, part: usize) -> u32 {
        let first = V::splat(LANE_INDEX[part * V::WIDTH]);
        let last = V::splat(LANE_INDEX[part * V::WIDTH + V::WIDTH - 1]);
        let (half_a, cutoff) = (V::splat(splat.half_a), V::splat(splat.cutoff));
        let mut bits = 0;
        for rows in 0..TILE / V::WIDTH {
            let ridge = V::load(&self.ridge, rows);
            let e = ridge.sub(ridge.max(first).min(last));
            let s = half_a.mul(e).mul_add(e, V::load(&self.quad, rows));
            bits |= V::bits(s.le(cutoff)) << (rows * V::WIDTH);
        }
        bits
    }
}

/// A splat's constants in every lane, for one part of the rows.
#[derive(Clone, Copy)]
struct Broadcast<V> {
    lane_index: V,
    half_a: V,
    cutoff: V,
    log2_opacity: V,
    color: [V; 3],
    alpha_cap: V,
    stop: V,
}

/// What one splat does to one part of a row, whether or not the pixels take it.
struct Attempt<V: Lanes> {
    e: V,
    /// Before and after the cap.
    uncapped: V,
    alpha: V,
    /// alpha·transmittance.
    weight: V,
    /// The transmittance that would be left.
    next: V,
    is_hit: V::Mask,
    /// Hit and neither stopped nor stopping.
    is_blended: V::Mask,
}

impl<V: Lanes> Broadcast<V> {
    #[inline(always)]
    fn new(splats: &PackedSplats, splat: &Packed, part: usize) -> Self {
        Self {
            lane_index: V::load(&LANE_INDEX, part),
            half_a: V::splat(splat.half_a),
            cutoff: V::splat(splat.cutoff),
            log2_opacity: V::splat(splat.log2_opacity),
            color: [V::splat(splat.color[0]), V::splat(splat.color[1]), V::splat(splat.color[2])],
            alpha_cap: V::splat(splats.alpha_cap),
            stop: V::splat(splats.stop),
        }
    }

    #[inline(always)]
    fn attempt(&self, rows: &SplatRows, row: usize, transmittance: V) -> Attempt<V> {
        let e = V::splat(rows.ridge[row]).sub(self.lane_index);
        let s = self.half_a.mul(e).mul_add(e, V::splat(rows.quad[row]));
        let is_hit = s.le(self.cutoff);
        let uncapped = exp2(self.log2_opacity.sub(s));
        let alpha = uncapped.min(self.alpha_cap);
        let weight = transmittance.mul(alpha);
        let next = transmittance.sub(weight);
        let is_blended = V::and(is_hit, self.stop.lt(next));
        Attempt { e, uncapped, alpha, weight, next, is_hit, is_blended }
    }

    /// The transmittance after an attempt; a row whose pixels have all stopped leaves `alive`.
    #[inline(always)]
    fn advance(&self, attempt: &Attempt<V>, transmittance: V, alive: &mut u32, row: usize) -> V {
        let zero = V::splat(0.0);
        let after = V::select(attempt.is_blended, attempt.next, transmittance);
        let is_stopping = V::and(attempt.is_hit, V::and(attempt.next.le(self.stop), zero.lt(transmittance)));
        if V::bits(is_stopping) == 0 {
            return after;
        }
        let after = V::select(is_stopping, transmittance.negate(), after);
        if V::bits(zero.lt(after)) == 0 {
            *alive &= !(1 << row);
        }
        after
    }
}

/// 2ˣ for x in [−126, 0]; anything elsewhere.
#[inline(always)]
fn exp2<V: Lanes>(x: V) -> V {
    let n = x.round();
    let f = x.sub(n);
    let mut polynomial = V::splat(EXP2[5]);
    for degree in [4, 3, 2, 1, 0] {
        polynomial = polynomial.mul_add(f, V::splat(EXP2[degree]));
    }
    polynomial.scale_by_power_of_two(n)
}

/// [`exp2`] of one number.
#[cfg(test)]
pub fn exp2_of(x: f32) -> f32 {
    let mut row = [0.0; TILE];
    exp2(Portable::splat(x)).store(&mut row, 0);
    row[0]
}

/// Transmittance 1 inside the image and "stopped" outside; per part, the rows that have a pixel inside.
#[inline(always)]
fn start<V: Lanes>(tile: &Tile, transmittance: &mut Plane) -> [u32; 2] {
    let [width, height] = tile.extent;
    for (y, row) in transmittance.iter_mut().enumerate() {
        for (x, value) in row.iter_mut().enumerate() {
            *value = if x < width && y < height { 1.0 } else { -1.0 };
        }
    }
    let alive_rows = (1 << height) - 1;
    [alive_rows, if V::WIDTH < width && V::WIDTH < TILE { alive_rows } else { 0 }]
}

#[inline(always)]
fn forward<V: Lanes, const EXTRAS: bool>(splats: &PackedSplats, tile: &Tile, planes: &mut [Plane]) -> u64 {
    let [transmittance, red, green, blue, extras @ ..] = planes else { unreachable!("four planes at least") };
    let mut alive = start::<V>(tile, transmittance);
    let mut blended_count = 0;
    for &rank in tile.ranks {
        let splat = &splats.splats[rank as usize];
        let rows = SplatRows::new::<V>(splat, tile);
        for part in 0..TILE / V::WIDTH {
            let mut hits = rows.hits::<V>(splat, part) & alive[part];
            let constants = Broadcast::<V>::new(splats, splat, part);
            while hits != 0 {
                let row = hits.trailing_zeros() as usize % TILE;
                hits &= hits - 1;
                let before = V::load(&transmittance[row], part);
                let attempt = constants.attempt(&rows, row, before);
                let weight = attempt.weight.keep(attempt.is_blended);
                blended_count += u64::from(V::bits(attempt.is_blended).count_ones());
                for (plane, value) in [&mut *red, &mut *green, &mut *blue].into_iter().zip(constants.color) {
                    weight.mul_add(value, V::load(&plane[row], part)).store(&mut plane[row], part);
                }
                if EXTRAS {
                    for (plane, &value) in extras.iter_mut().zip(splats.extras(rank)) {
                        weight.mul_add(V::splat(value), V::load(&plane[row], part)).store(&mut plane[row], part);
                    }
                }
                constants.advance(&attempt, before, &mut alive[part], row).store(&mut transmittance[row], part);
            }
        }
        if alive == [0, 0] {
            break;
        }
    }
    transmittance.as_flattened_mut().iter_mut().for_each(|value| *value = value.abs());
    blended_count
}

#[inline(always)]
fn backward<V: Lanes, const EXTRAS: bool>(
    splats: &PackedSplats,
    tile: &Tile,
    planes: &mut [Plane],
    gradient_rows: &mut [f32],
) {
    let [remaining, red, green, blue, extras @ ..] = planes else { unreachable!("four planes at least") };
    let mut transmittance: Plane = [[0.0; TILE]; TILE];
    let mut alive = start::<V>(tile, &mut transmittance);
    let zero = V::splat(0.0);
    let one = V::splat(1.0);
    let mut extra_sums = vec![[zero; 2]; extras.len()];
    let gradient_rows = gradient_rows.chunks_exact_mut(ROW_COLORS + 3 + extras.len());
    for (&rank, gradient_row) in tile.ranks.iter().zip(gradient_rows) {
        let splat = &splats.splats[rank as usize];
        let rows = SplatRows::new::<V>(splat, tile);
        // Per part: Σ v·(1, e, e², e·dy, dy, dy²) with v = ∂/∂σ, then Σ weight·gradient of red and green, and of blue.
        let mut sums = [[zero; 8]; 2];
        let mut blue_sums = [zero; 2];
        for part in 0..TILE / V::WIDTH {
            let mut hits = rows.hits::<V>(splat, part) & alive[part];
            let constants = Broadcast::<V>::new(splats, splat, part);
            let [mut sum_1, mut sum_e, mut sum_ee, mut sum_ey, mut sum_y, mut sum_yy, mut sum_r, mut sum_g] = [zero; 8];
            let mut sum_b = zero;
            while hits != 0 {
                let row = hits.trailing_zeros() as usize % TILE;
                hits &= hits - 1;
                let before = V::load(&transmittance[row], part);
                let attempt = constants.attempt(&rows, row, before);
                let weight = attempt.weight.keep(attempt.is_blended);

                // φ = value·gradient over all channels.
                let (g_r, g_g, g_b) = (V::load(&red[row], part), V::load(&green[row], part), V::load(&blue[row], part));
                let [r, g, b] = constants.color;
                let mut phi = r.mul(g_r);
                phi = g.mul_add(g_g, phi);
                phi = b.mul_add(g_b, phi);
                sum_r = weight.mul_add(g_r, sum_r);
                sum_g = weight.mul_add(g_g, sum_g);
                sum_b = weight.mul_add(g_b, sum_b);
                if EXTRAS {
                    for ((plane, &value), sum) in extras.iter().zip(splats.extras(rank)).zip(&mut extra_sums) {
                        let gradient = V::load(&plane[row], part);
                        phi = V::splat(value).mul_add(gradient, phi);
                        sum[part] = weight.mul_add(gradient, sum[part]);
                    }
                }

                // ∂/∂alpha = (next·φ − remaining)/(1 − alpha) and ∂alpha/∂σ = −alpha, 0 where capped.
                let remains = weight.neg_mul_add(phi, V::load(&remaining[row], part));
                remains.store(&mut remaining[row], part);
                let is_free = V::and(attempt.is_blended, attempt.uncapped.lt(constants.alpha_cap));
                let slope = attempt.alpha.div(one.sub(attempt.alpha));
                let v = attempt.next.neg_mul_add(phi, remains).mul(slope).keep(is_free);

                let dy = V::splat(rows.dy[row]);
                let (v_e, v_y) = (v.mul(attempt.e), v.mul(dy));
                sum_1 = sum_1.add(v);
                sum_e = sum_e.add(v_e);
                sum_ee = v_e.mul_add(attempt.e, sum_ee);
                sum_ey = v_e.mul_add(dy, sum_ey);
                sum_y = sum_y.add(v_y);
                sum_yy = v_y.mul_add(dy, sum_yy);
                constants.advance(&attempt, before, &mut alive[part], row).store(&mut transmittance[row], part);
            }
            sums[part] = [sum_1, sum_e, sum_ee, sum_ey, sum_y, sum_yy, sum_r, sum_g];
            blue_sums[part] = sum_b;
        }
        gradient_row[ROW_MOMENTS..ROW_MOMENTS + 8].copy_from_slice(&V::sum8(&sums[0], &sums[1]));
        gradient_row[ROW_COLORS + 2] = V::sum(blue_sums[0], blue_sums[1]);
        if EXTRAS {
            for (sum, out) in extra_sums.iter_mut().zip(&mut gradient_row[ROW_COLORS + 3..]) {
                *out = V::sum(sum[0], sum[1]);
                *sum = [zero; 2];
            }
        }
        if alive == [0, 0] {
            break;
        }
    }
}

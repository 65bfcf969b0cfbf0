//! The kernel of the fast body: one tile, splat by splat, a vector of pixels at a time.
//!
//! Exponentials are powers of two: s = σ·log₂e, alpha = 2^(log₂ opacity − s). A pixel that has stopped keeps its
//! transmittance with the sign flipped, so that any later attempt leaves less than the stop. Backward replays forward
//! with the same instructions, and hence with the same decisions.

#[cfg(test)]
use super::lanes::Portable;
use super::lanes::{Lanes, Row};
use super::packed::{Packed, PackedSplats, Tile};
use super::{ROW_COLORS, ROW_MOMENTS};
use crate::rasteriser::binning::TILE;

/// A value per pixel of a tile.
pub(crate) type Plane = [Row; TILE];

const LANE_INDEX: Row = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

/// Minimax polynomial of 2ˣ on [−½, ½] (Remez, relative error 1.6e-7 with these coefficients in f32), constant term first.
const EXP2: [f32; 6] = [1.000_000_1, 0.693_146_94, 0.240_221_2, 0.055_507_13, 0.009_675_541, 0.001_327_647_2];

/// The terms of one splat for each row of a tile.
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
    /// rounding is monotone, so the nearest pixel decides.
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

/// The effect of one splat on one part of a row, before the pixels accept or reject it.
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
        // The minimum avoids denormal numbers in pixels far outside, each of which would cost a hundred cycles.
        let uncapped = exp2(self.log2_opacity.sub(s.min(self.cutoff)));
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

/// 2ˣ for x in [−126, 127].
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
pub(crate) fn exp2_of(x: f32) -> f32 {
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

/// See [`PackedSplats::forward`].
#[inline(always)]
pub(super) fn forward<V: Lanes, const EXTRAS: bool>(splats: &PackedSplats, tile: &Tile, planes: &mut [Plane]) -> u64 {
    let [transmittance, red, green, blue, extras @ ..] = planes else { unreachable!("four planes at least") };
    let mut alive = start::<V>(tile, transmittance);
    let mut blended_count = 0;
    for &rank in tile.ranks {
        let splat = &splats.splats[rank as usize];
        let rows = SplatRows::new::<V>(splat, tile);
        for (part, alive) in alive.iter_mut().enumerate().take(TILE / V::WIDTH) {
            let mut hits = rows.hits::<V>(splat, part) & *alive;
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
                constants.advance(&attempt, before, alive, row).store(&mut transmittance[row], part);
            }
        }
        if alive == [0, 0] {
            break;
        }
    }
    transmittance.as_flattened_mut().iter_mut().for_each(|value| *value = value.abs());
    blended_count
}

/// The state of the backward pass of a tile.
struct Backward<'a, V> {
    transmittance: Plane,
    /// Per part, the rows with a pixel that has not stopped.
    alive: [u32; 2],
    /// Σ weight·φ of the splats behind.
    remaining: &'a mut Plane,
    /// Gradients of the image.
    red: &'a Plane,
    green: &'a Plane,
    blue: &'a Plane,
    extras: &'a [Plane],
    /// Per extra and part, Σ weight·gradient of the current splat.
    extra_sums: Vec<[V; 2]>,
}

/// Sums over the pixels of one part.
#[derive(Clone, Copy)]
struct Sums<V> {
    /// Σ v·(1, e, e², e·dy, dy, dy²) with v = ∂/∂σ, then Σ weight·gradient of red and green.
    moments_red_green: [V; 8],
    blue: V,
}

/// See [`PackedSplats::backward`].
#[inline(always)]
pub(super) fn backward<V: Lanes, const EXTRAS: bool>(
    splats: &PackedSplats,
    tile: &Tile,
    planes: &mut [Plane],
    gradient_rows: &mut [f32],
) {
    let [remaining, red, green, blue, extras @ ..] = planes else { unreachable!("four planes at least") };
    let mut transmittance: Plane = [[0.0; TILE]; TILE];
    let alive = start::<V>(tile, &mut transmittance);
    let zero = V::splat(0.0);
    let extra_sums = vec![[zero; 2]; extras.len()];
    let mut state = Backward { transmittance, alive, remaining, red, green, blue, extras, extra_sums };
    let gradient_rows = gradient_rows.chunks_exact_mut(ROW_COLORS + 3 + state.extras.len());
    for (&rank, gradient_row) in tile.ranks.iter().zip(gradient_rows) {
        let rows = SplatRows::new::<V>(&splats.splats[rank as usize], tile);
        let mut sums = [Sums { moments_red_green: [zero; 8], blue: zero }; 2];
        for (part, sums) in sums.iter_mut().enumerate().take(TILE / V::WIDTH) {
            *sums = state.part::<EXTRAS>(splats, rank, &rows, part);
        }
        let [left, right] = &sums;
        let moments_red_green = V::sum8(&left.moments_red_green, &right.moments_red_green);
        gradient_row[ROW_MOMENTS..ROW_MOMENTS + 8].copy_from_slice(&moments_red_green);
        gradient_row[ROW_COLORS + 2] = V::sum(left.blue, right.blue);
        if EXTRAS {
            for (sum, out) in state.extra_sums.iter_mut().zip(&mut gradient_row[ROW_COLORS + 3..]) {
                *out = V::sum(sum[0], sum[1]);
                *sum = [zero; 2];
            }
        }
        if state.alive == [0, 0] {
            break;
        }
    }
}

impl<V: Lanes> Backward<'_, V> {
    /// One splat over one part of all rows.
    #[inline(always)]
    fn part<const EXTRAS: bool>(&mut self, splats: &PackedSplats, rank: u32, rows: &SplatRows, part: usize) -> Sums<V> {
        let splat = &splats.splats[rank as usize];
        let constants = Broadcast::<V>::new(splats, splat, part);
        let mut alive = self.alive[part];
        let mut hits = rows.hits::<V>(splat, part) & alive;
        let one = V::splat(1.0);
        let [mut sum_1, mut sum_e, mut sum_ee, mut sum_ey, mut sum_y, mut sum_yy] = [V::splat(0.0); 6];
        let [mut sum_r, mut sum_g, mut sum_b] = [V::splat(0.0); 3];
        while hits != 0 {
            let row = hits.trailing_zeros() as usize % TILE;
            hits &= hits - 1;
            let before = V::load(&self.transmittance[row], part);
            let attempt = constants.attempt(rows, row, before);
            let weight = attempt.weight.keep(attempt.is_blended);

            // φ = Σ value·gradient over the channels.
            let [r, g, b] = constants.color;
            let (g_r, g_g) = (V::load(&self.red[row], part), V::load(&self.green[row], part));
            let g_b = V::load(&self.blue[row], part);
            let mut phi = b.mul_add(g_b, g.mul_add(g_g, r.mul(g_r)));
            sum_r = weight.mul_add(g_r, sum_r);
            sum_g = weight.mul_add(g_g, sum_g);
            sum_b = weight.mul_add(g_b, sum_b);
            if EXTRAS {
                phi = self.extras(splats.extras(rank), row, part, weight, phi);
            }

            // ∂/∂alpha = (next·φ − remaining)/(1 − alpha) and ∂alpha/∂σ = −alpha, 0 where capped.
            let remaining = weight.neg_mul_add(phi, V::load(&self.remaining[row], part));
            remaining.store(&mut self.remaining[row], part);
            let is_free = V::and(attempt.is_blended, attempt.uncapped.lt(constants.alpha_cap));
            let slope = attempt.alpha.div(one.sub(attempt.alpha));
            let v = attempt.next.neg_mul_add(phi, remaining).mul(slope).keep(is_free);

            let dy = V::splat(rows.dy[row]);
            let (v_e, v_y) = (v.mul(attempt.e), v.mul(dy));
            sum_1 = sum_1.add(v);
            sum_e = sum_e.add(v_e);
            sum_ee = v_e.mul_add(attempt.e, sum_ee);
            sum_ey = v_e.mul_add(dy, sum_ey);
            sum_y = sum_y.add(v_y);
            sum_yy = v_y.mul_add(dy, sum_yy);
            constants.advance(&attempt, before, &mut alive, row).store(&mut self.transmittance[row], part);
        }
        self.alive[part] = alive;
        let moments_red_green = [sum_1, sum_e, sum_ee, sum_ey, sum_y, sum_yy, sum_r, sum_g];
        Sums { moments_red_green, blue: sum_b }
    }

    /// Adds value·gradient of the extras to φ, and weight·gradient to their sums.
    #[inline(always)]
    fn extras(&mut self, values: &[f32], row: usize, part: usize, weight: V, mut phi: V) -> V {
        for ((plane, &value), sum) in self.extras.iter().zip(values).zip(&mut self.extra_sums) {
            let gradient = V::load(&plane[row], part);
            phi = V::splat(value).mul_add(gradient, phi);
            sum[part] = weight.mul_add(gradient, sum[part]);
        }
        phi
    }
}

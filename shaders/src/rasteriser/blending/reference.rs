//! The readable body, for f32 and f64: one tile, pixel by pixel.

use super::packed::Tile;
use super::{Constants, PIXELS, ROW_COLORS, ROW_MOMENTS, RankedSplats};
use crate::rasteriser::binning::TILE;
use crate::tape::Real;

/// The terms of one splat at one pixel.
struct Sample<T> {
    e: T,
    dy: T,
    alpha: T,
    /// ∂alpha/∂σ.
    alpha_by_sigma: T,
}

/// `None` if σ is above the cutoff.
fn sample<T: Real>(
    splats: &RankedSplats<T>,
    rank: usize,
    [x, y]: [T; 2],
    constants: &Constants<T>,
) -> Option<Sample<T>> {
    let [u, v, a, k, m, opacity, cutoff, ..] = splats.records[rank];
    let dy = v - y;
    let e = u - x + k * dy;
    let sigma = T::from_f64(0.5) * (a * e * e + m * dy * dy);
    if !(sigma <= cutoff) {
        return None;
    }
    let uncapped = opacity * (-sigma).exp();
    let (fade, fade_slope) = constants.fade(uncapped);
    let is_free = uncapped < constants.alpha_cap;
    let capped = if is_free { uncapped } else { constants.alpha_cap };
    let alpha_by_uncapped = if is_free { fade } else { T::ZERO } + capped * fade_slope;
    Some(Sample { e, dy, alpha: capped * fade, alpha_by_sigma: -uncapped * alpha_by_uncapped })
}

/// The pixels of a tile that lie in the image: place in a plane and centre.
fn pixels<T: Real>(tile: &Tile) -> impl Iterator<Item = (usize, [T; 2])> {
    let ([left, top], [width, height]) = (tile.origin, tile.extent);
    let center = move |x: usize, y: usize| [left + x, top + y].map(|pixel| T::from_f64(pixel as f64 + 0.5));
    (0..height).flat_map(move |y| (0..width).map(move |x| (y * TILE + x, center(x, y))))
}

/// Planes: transmittance, three colours, extras. Returns the number of blended (pixel, splat) pairs.
pub(super) fn forward<T: Real>(
    splats: &RankedSplats<T>,
    constants: &Constants<T>,
    tile: &Tile,
    planes: &mut [T],
) -> u64 {
    planes[..PIXELS].fill(T::ONE);
    let mut blended_count = 0;
    for (pixel, center) in pixels(tile) {
        let mut transmittance = T::ONE;
        for &rank in tile.ranks {
            let Some(sample) = sample(splats, rank as usize, center, constants) else { continue };
            let next = transmittance * (T::ONE - sample.alpha);
            if next <= constants.stop {
                break;
            }
            for (channel, value) in splats.channels(rank as usize).enumerate() {
                planes[(1 + channel) * PIXELS + pixel] += sample.alpha * transmittance * value;
            }
            transmittance = next;
            blended_count += 1;
        }
        planes[pixel] = transmittance;
    }
    blended_count
}

/// Planes: Σ weight·φ of the splats behind, then the gradients of three colours and the extras. Adds one
/// row per splat of the tile.
pub(super) fn backward<T: Real>(
    splats: &RankedSplats<T>,
    constants: &Constants<T>,
    tile: &Tile,
    planes: &[T],
    rows: &mut [T],
) {
    let row_len = ROW_COLORS + planes.len() / PIXELS - 1;
    for (pixel, center) in pixels(tile) {
        let (mut transmittance, mut remaining) = (T::ONE, planes[pixel]);
        for (&rank, row) in tile.ranks.iter().zip(rows.chunks_exact_mut(row_len)) {
            let Some(sample) = sample(splats, rank as usize, center, constants) else { continue };
            let next = transmittance * (T::ONE - sample.alpha);
            if next <= constants.stop {
                break;
            }
            // φ = value·gradient over all channels.
            let (mut phi, weight) = (T::ZERO, sample.alpha * transmittance);
            for (channel, value) in splats.channels(rank as usize).enumerate() {
                let gradient = planes[(1 + channel) * PIXELS + pixel];
                phi += value * gradient;
                row[ROW_COLORS + channel] += weight * gradient;
            }
            remaining -= weight * phi;
            let g_alpha = transmittance * phi - remaining / (T::ONE - sample.alpha);
            let g_sigma = g_alpha * sample.alpha_by_sigma;
            let Sample { e, dy, .. } = sample;
            for (sum, factor) in row[ROW_MOMENTS..].iter_mut().zip([T::ONE, e, e * e, e * dy, dy, dy * dy]) {
                *sum += g_sigma * factor;
            }
            transmittance = next;
        }
    }
}

//! Block matching of a masked subject between two frames: displacements of pixels without an optical-flow estimator.

use rayon::prelude::*;
use scene::Mask;

/// Half the side of a block, pixels.
const BLOCK: i32 = 3;
/// Largest displacement beyond that of the mask's centre, as a share of the image's width.
const REACH_SHARE: f64 = 0.08;
/// Step of the coarse search, pixels.
const COARSE_STEP: i32 = 2;
/// Reach of the search around the median of the neighbours, pixels.
const REFINE: i32 = 3;
/// Distance in pixels within which displacements are compared.
const NEIGHBORHOOD: i32 = 8;
/// Cost of a pixel that leaves the mask, in grey levels of each channel: more than noise, less than an edge.
const OUTSIDE: u32 = 60;
/// Cost per pixel of distance from the predicted displacement, in grey levels: a tie-breaker.
const PER_PIXEL: u32 = 2;

/// An 8-bit RGB image [H, W, 3] with the mask of its moving pixels.
pub(super) struct Frame<'a> {
    pub(super) pixels: &'a [u8],
    pub(super) moving: &'a Mask,
}

/// The displacement from `from` to `to` of the pixels (column, row), which lie in the mask of `from`; `None` if one of
/// the masks is empty. Blocks are compared where they lie in the mask of `from`; the displacement of every pixel is
/// searched around the median of its neighbours'.
pub(super) fn displacements(from: &Frame<'_>, to: &Frame<'_>, places: &[[i32; 2]]) -> Option<Vec<[i32; 2]>> {
    let shift = {
        let ([x, y], [to_x, to_y]) = (center(from.moving)?, center(to.moving)?);
        [(to_x - x).round() as i32, (to_y - y).round() as i32]
    };
    let reach = (REACH_SHARE * f64::from(from.moving.width)).ceil() as i32;
    let search = |place: &[i32; 2]| {
        let coarse = best(from, to, *place, shift, reach, COARSE_STEP);
        best(from, to, *place, coarse, COARSE_STEP - 1, 1)
    };
    let first: Vec<[i32; 2]> = places.par_iter().map(search).collect();
    let refine = |at: usize| best(from, to, places[at], median_near(places, &first, at), REFINE, 1);
    let second: Vec<[i32; 2]> = (0..places.len()).into_par_iter().map(refine).collect();
    Some((0..places.len()).into_par_iter().map(|at| median_near(places, &second, at)).collect())
}

/// The mean pixel of a mask; `None` for an empty one.
fn center(mask: &Mask) -> Option<[f64; 2]> {
    let width = mask.width as usize;
    let set = mask.inside.iter().enumerate().filter(|(_, inside)| **inside);
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for (at, _) in set {
        sum = [sum[0] + (at % width) as f64, sum[1] + (at / width) as f64];
        count += 1.0;
    }
    (count > 0.0).then(|| sum.map(|sum| sum / count))
}

/// The displacement of least cost within `reach` of `around`.
fn best(from: &Frame<'_>, to: &Frame<'_>, place: [i32; 2], around: [i32; 2], reach: i32, step: i32) -> [i32; 2] {
    let steps = reach / step;
    let offsets = (-steps..=steps).flat_map(|y| (-steps..=steps).map(move |x| [step * x, step * y]));
    let cost = |offset: &[i32; 2]| {
        let displacement = [around[0] + offset[0], around[1] + offset[1]];
        let far = offset[0].unsigned_abs() + offset[1].unsigned_abs();
        let pixels = (2 * BLOCK as u32 + 1).pow(2);
        cost(from, to, place, displacement) + PER_PIXEL * far * pixels / 4
    };
    let found = offsets.min_by_key(|offset| (cost(offset), offset[0].abs() + offset[1].abs(), *offset));
    found.map_or(around, |[x, y]| [around[0] + x, around[1] + y])
}

/// The sum of absolute differences of the masked pixels of a block, over all channels.
fn cost(from: &Frame<'_>, to: &Frame<'_>, [column, row]: [i32; 2], [right, down]: [i32; 2]) -> u32 {
    let (width, height) = (from.moving.width as i32, from.moving.height as i32);
    let inside = |x: i32, y: i32| (0..width).contains(&x) && (0..height).contains(&y);
    let mut sum = 0;
    for (x, y) in (row - BLOCK..=row + BLOCK).flat_map(|y| (column - BLOCK..=column + BLOCK).map(move |x| (x, y))) {
        if !inside(x, y) || !from.moving.inside[(y * width + x) as usize] {
            continue;
        }
        let (to_x, to_y) = (x + right, y + down);
        if !inside(to_x, to_y) || !to.moving.inside[(to_y * width + to_x) as usize] {
            sum += 3 * OUTSIDE;
            continue;
        }
        let [a, b] = [(from.pixels, y * width + x), (to.pixels, to_y * width + to_x)]
            .map(|(pixels, at)| &pixels[3 * at as usize..][..3]);
        sum += a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum::<u32>();
    }
    sum
}

/// The median displacement, per axis, of the places near one of them (itself included).
fn median_near(places: &[[i32; 2]], displacements: &[[i32; 2]], at: usize) -> [i32; 2] {
    let near = |place: &[i32; 2]| (0..2).all(|axis| (place[axis] - places[at][axis]).abs() <= NEIGHBORHOOD);
    let chosen: Vec<[i32; 2]> =
        places.iter().zip(displacements).filter(|(place, _)| near(place)).map(|(_, found)| *found).collect();
    [0, 1].map(|axis| {
        let mut values: Vec<i32> = chosen.iter().map(|found| found[axis]).collect();
        let middle = values.len() / 2;
        *values.select_nth_unstable(middle).1
    })
}

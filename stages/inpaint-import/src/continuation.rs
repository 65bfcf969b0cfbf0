//! Depth behind moving pixels, continued from their surroundings.

use std::f64::consts::PI;

use scene::{DepthMap, Mask, pixels};

/// A hole is filled when no pixel changes by a larger share of the mean inverse depth.
const CONVERGED: f64 = 1e-5;

/// The depth in a hole of a map: every inverse depth is the mean of its neighbours', so that planes are continued
/// exactly, because their inverse depth is linear in the image. 0 in parts of the hole without known depth around them.
pub(crate) fn continued(depth: &DepthMap, hole: &Mask) -> DepthMap {
    let inverse = |(&z, &inside): (&f32, &bool)| if z > 0.0 && !inside { 1.0 / f64::from(z) } else { 0.0 };
    let mut inverse_depths: Vec<f64> = depth.depth_view.iter().zip(&hole.inside).map(inverse).collect();
    for part in hole.components() {
        fill(&mut inverse_depths, &part, [hole.width, hole.height]);
    }
    let depth_of = |&inverse: &f64| if inverse > 0.0 { (1.0 / inverse) as f32 } else { 0.0 };
    DepthMap { depth_view: inverse_depths.iter().map(depth_of).collect(), ..*depth }
}

/// Fills a connected part whose values are 0, by successive over-relaxation; other pixels with value 0 are ignored.
fn fill(inverse_depths: &mut [f64], part: &[usize], [width, height]: [u32; 2]) {
    let known = |values: &[f64], at: usize| -> Vec<usize> {
        pixels::neighbors(at, width, height).filter(|&other| values[other] > 0.0).collect()
    };
    let rim: Vec<f64> =
        part.iter().flat_map(|&at| known(inverse_depths, at)).map(|other| inverse_depths[other]).collect();
    if rim.is_empty() {
        return;
    }
    let mean = rim.iter().sum::<f64>() / rim.len() as f64;
    part.iter().for_each(|&at| inverse_depths[at] = mean);
    let links: Vec<(usize, Vec<usize>)> = part.iter().map(|&at| (at, known(inverse_depths, at))).collect();
    // The best factor for a square that is open at one side; it converges for every shape.
    let factor = 2.0 / (1.0 + (PI / (2.0 * extent(part, width as usize) as f64)).sin());
    loop {
        let mut largest = 0.0_f64;
        for (at, others) in &links {
            let sum: f64 = others.iter().map(|&other| inverse_depths[other]).sum();
            let change = factor * (sum / others.len() as f64 - inverse_depths[*at]);
            inverse_depths[*at] += change;
            largest = largest.max(change.abs());
        }
        if largest <= CONVERGED * mean {
            return;
        }
    }
}

/// The larger side of the bounding box of pixels, with their rim.
fn extent(part: &[usize], width: usize) -> usize {
    let side = |place: &dyn Fn(usize) -> usize| {
        let places = || part.iter().map(|&at| place(at));
        places().max().unwrap_or(0) - places().min().unwrap_or(0) + 2
    };
    side(&|at| at % width).max(side(&|at| at / width))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [40, 30];

    /// The depth of a plane, and a hole of some columns and rows in which an object is.
    fn plane(columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> (DepthMap, DepthMap, Mask) {
        let [width, height] = SIZE;
        let depth = |at: usize| (1.0 / (0.2 + 0.002 * (at % width) as f64 + 0.003 * (at / width) as f64)) as f32;
        let depth_view = (0..width * height).map(depth).collect();
        let behind = DepthMap { width: width as u32, height: height as u32, depth_view };
        let mut hole = Mask::empty(behind.width, behind.height);
        rows.flat_map(|row| columns.clone().map(move |column| row * width + column))
            .for_each(|at| hole.inside[at] = true);
        let seen = (0..width * height).map(|at| if hole.inside[at] { 1.0 } else { behind.depth_view[at] }).collect();
        (DepthMap { depth_view: seen, ..behind }, behind, hole)
    }

    #[test]
    fn planes_are_continued_exactly() {
        let (seen, behind, hole) = plane(8..24, 6..18);
        for (found, expected) in continued(&seen, &hole).depth_view.iter().zip(&behind.depth_view) {
            assert!((found / expected - 1.0).abs() <= 1e-4, "{found} instead of {expected}");
        }
    }

    #[test]
    fn depth_beyond_the_image_and_unknown_depth_are_ignored() {
        let (mut seen, behind, hole) = plane(0..20, 12..30);
        // The column to the right of the hole is unknown.
        (0..SIZE[1]).for_each(|row| seen.depth_view[row * SIZE[0] + 20] = 0.0);
        let range = [behind.depth_view.last().unwrap(), &behind.depth_view[0]];
        let found = continued(&seen, &hole);
        let filled = found.depth_view.iter().zip(&hole.inside).filter(|(_, inside)| **inside);
        for (depth, _) in filled {
            assert!((*range[0]..=*range[1]).contains(depth), "{depth}");
        }
        seen.depth_view.fill(0.0);
        assert!(continued(&seen, &hole).depth_view.iter().all(|&depth| depth == 0.0));
    }
}

//! Depth behind moving pixels, continued from their surroundings.

use glam::{DMat2, DVec2};
use scene::{DepthMap, Mask, pixels};

/// Averaging passes at each size. The solution at half the size is near, so that only small structures are left to smooth.
const SWEEPS: usize = 32;
/// Smallest standard deviation of the rim, relative to that of the hole, that shows how depth changes in a direction.
const LEAST_SPREAD: f64 = 0.6;
/// Least inverse depth, as a share of the least one around the hole: a plane may meet its horizon in the hole.
const LEAST_SHARE: f64 = 0.5;

/// Fills a hole of a depth map. In each connected part, inverse depth continues the plane fitted to the rim, because
/// the inverse depth of a plane is linear in the image; the residuals at the rim are continued smoothly. Parts without
/// known depth at their rim become 0.
pub(crate) fn continued(depth: &DepthMap, hole: &Mask) -> DepthMap {
    let inverse = |(&z, &inside): (&f32, &bool)| if z > 0.0 && !inside { 1.0 / f64::from(z) } else { 0.0 };
    let mut inverse_depths: Vec<f64> = depth.depth_view.iter().zip(&hole.inside).map(inverse).collect();
    for part in hole.components() {
        fill(&mut inverse_depths, &part, [hole.width, hole.height]);
    }
    let depth_of = |&inverse: &f64| if inverse > 0.0 { (1.0 / inverse) as f32 } else { 0.0 };
    DepthMap { depth_view: inverse_depths.iter().map(depth_of).collect(), ..*depth }
}

/// Fills a connected part whose values are 0; other pixels with value 0 are ignored.
fn fill(inverse_depths: &mut [f64], part: &[usize], [width, height]: [u32; 2]) {
    let around = part.iter().flat_map(|&at| pixels::neighbors(at, width, height));
    let mut rim: Vec<usize> = around.filter(|&at| inverse_depths[at] > 0.0).collect();
    rim.sort_unstable();
    rim.dedup();
    if rim.is_empty() {
        return;
    }
    let known = rim.iter().map(|&at| inverse_depths[at]);
    let (least, most) = known.clone().fold((f64::INFINITY, 0.0_f64), |(least, most), at| (least.min(at), most.max(at)));
    // At the border of the image, a plane may leave the range of the rim, at a corner by this range.
    let is_at_border = |at: &usize| pixels::neighbors(*at, width, height).count() < 8;
    let beyond = if part.iter().any(is_at_border) { most - least } else { 0.0 };
    let range = [(least - beyond).max(LEAST_SHARE * least), most + beyond];
    let place = |at: &usize| pixels::center(*at, width);
    let places: Vec<DVec2> = rim.iter().map(place).collect();
    let hole: Vec<DVec2> = part.iter().map(place).collect();
    let plane = Plane::of(&places, &known.collect::<Vec<_>>(), &hole);
    let (mut grid, cell) = Grid::around(part, width as usize);
    for &at in &rim {
        grid.cells[cell(at)] = Cell::Rim;
        grid.values[cell(at)] = inverse_depths[at] - plane.at(place(&at));
    }
    grid.fill();
    for at in part {
        inverse_depths[*at] = (plane.at(place(at)) + grid.values[cell(*at)]).clamp(range[0], range[1]);
    }
}

/// A linear function of places in an image.
struct Plane {
    center: DVec2,
    value: f64,
    slope: DVec2,
}

impl Plane {
    /// The plane with the least squares of differences to values at `places`, for use in a `hole`. It is level in a direction in
    /// which the places are too close together.
    fn of(places: &[DVec2], values: &[f64], hole: &[DVec2]) -> Self {
        let count = places.len() as f64;
        let (center, spread) = covariance(places);
        let (_, needed) = covariance(hole);
        let value = values.iter().sum::<f64>() / count;
        let slope_along = |axis: DVec2| {
            let [variance, of_hole] = [spread, needed].map(|spread| axis.dot(spread * axis));
            if variance <= 0.0 || variance < LEAST_SPREAD.powi(2) * of_hole {
                return DVec2::ZERO;
            }
            let products = places.iter().zip(values).map(|(place, other)| (place - center).dot(axis) * (other - value));
            axis * (products.sum::<f64>() / (count * variance))
        };
        // Along its principal axes, the places are uncorrelated.
        let axis = DVec2::from_angle(0.5 * (2.0 * spread.x_axis.y).atan2(spread.x_axis.x - spread.y_axis.y));
        Self { center, value, slope: slope_along(axis) + slope_along(axis.perp()) }
    }

    fn at(&self, place: DVec2) -> f64 {
        self.value + self.slope.dot(place - self.center)
    }
}

/// The mean of places, and their covariance.
fn covariance(places: &[DVec2]) -> (DVec2, DMat2) {
    let count = places.len() as f64;
    let center = places.iter().sum::<DVec2>() / count;
    let outer = |from: DVec2| DMat2::from_cols(from * from.x, from * from.y);
    let sum = places.iter().fold(DMat2::ZERO, |sum, place| sum + outer(place - center));
    (center, sum * (1.0 / count))
}

#[derive(Clone, Copy, PartialEq)]
enum Cell {
    Unknown,
    Rim,
    Hole,
}

/// A hole and its rim.
struct Grid {
    width: usize,
    height: usize,
    cells: Vec<Cell>,
    /// 0 where unknown.
    values: Vec<f64>,
}

impl Grid {
    /// The bounding box of a part of an image with this width, and one cell around it; with the cell of a pixel.
    fn around(part: &[usize], image_width: usize) -> (Self, impl Fn(usize) -> usize) {
        let range = |place: &dyn Fn(usize) -> usize| {
            let places = || part.iter().map(|&at| place(at));
            (places().min().unwrap_or(0), places().max().unwrap_or(0))
        };
        let (left, right) = range(&|at| at % image_width);
        let (top, bottom) = range(&|at| at / image_width);
        let [width, height] = [right - left + 3, bottom - top + 3];
        let cell = move |at: usize| (at / image_width + 1 - top) * width + at % image_width + 1 - left;
        let mut grid = Self::unknown(width, height);
        part.iter().for_each(|&at| grid.cells[cell(at)] = Cell::Hole);
        (grid, cell)
    }

    fn unknown(width: usize, height: usize) -> Self {
        let count = width * height;
        Self { width, height, cells: vec![Cell::Unknown; count], values: vec![0.0; count] }
    }

    /// Moves the values of the hole towards the mean of their neighbours, from the solution at half the size.
    fn fill(&mut self) {
        let hole: Vec<usize> = (0..self.cells.len()).filter(|&at| self.cells[at] == Cell::Hole).collect();
        if hole.is_empty() {
            return;
        }
        let mut half = self.halved();
        half.fill();
        hole.iter().for_each(|&at| self.values[at] = half.values[self.half(at)]);
        // The neighbours of all cells of the hole, in turn, and where those of a cell end.
        let (mut links, mut ends) = (Vec::new(), Vec::with_capacity(hole.len()));
        for &at in &hole {
            let around = pixels::neighbors(at, self.width as u32, self.height as u32);
            links.extend(around.filter(|&other| self.cells[other] != Cell::Unknown));
            ends.push(links.len());
        }
        for _ in 0..SWEEPS {
            let mut first = 0;
            for (&at, &end) in hole.iter().zip(&ends) {
                let sum: f64 = links[first..end].iter().map(|&other| self.values[other]).sum();
                self.values[at] = sum / (end - first) as f64;
                first = end;
            }
        }
    }

    /// Half the size: cells with a part of the rim have its mean.
    fn halved(&self) -> Self {
        let mut half = Self::unknown(self.width.div_ceil(2), self.height.div_ceil(2));
        let mut counts = vec![0_usize; half.cells.len()];
        for (at, cell) in self.cells.iter().enumerate() {
            let to = self.half(at);
            match cell {
                Cell::Unknown => (),
                Cell::Rim => {
                    half.cells[to] = Cell::Rim;
                    half.values[to] += self.values[at];
                    counts[to] += 1;
                }
                Cell::Hole if half.cells[to] == Cell::Unknown => half.cells[to] = Cell::Hole,
                Cell::Hole => (),
            }
        }
        half.values.iter_mut().zip(counts).for_each(|(value, count)| *value /= count.max(1) as f64);
        half
    }

    /// The cell at half the size that contains a cell.
    fn half(&self, at: usize) -> usize {
        (at / self.width / 2) * self.width.div_ceil(2) + at % self.width / 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [40, 30];

    /// The inverse depth of a plane in an image of [`SIZE`].
    fn plane(x: f64, y: f64) -> f64 {
        0.2 + 0.002 * x + 0.003 * y
    }

    /// The depth of a surface, and a hole of some columns and rows in which an object is.
    fn surface(
        [width, height]: [usize; 2],
        inverse: impl Fn(f64, f64) -> f64,
        columns: std::ops::Range<usize>,
        rows: std::ops::Range<usize>,
    ) -> (DepthMap, DepthMap, Mask) {
        let depth = |at: usize| (1.0 / inverse((at % width) as f64, (at / width) as f64)) as f32;
        let depth_view = (0..width * height).map(depth).collect();
        let behind = DepthMap { width: width as u32, height: height as u32, depth_view };
        let mut hole = Mask::empty(behind.width, behind.height);
        rows.flat_map(|row| columns.clone().map(move |column| row * width + column))
            .for_each(|at| hole.inside[at] = true);
        let seen = (0..width * height).map(|at| if hole.inside[at] { 1.0 } else { behind.depth_view[at] }).collect();
        (DepthMap { depth_view: seen, ..behind }, behind, hole)
    }

    /// The largest relative error of the continued depth.
    fn error((seen, behind, hole): &(DepthMap, DepthMap, Mask)) -> f32 {
        let found = continued(seen, hole).depth_view;
        found.iter().zip(&behind.depth_view).map(|(found, expected)| (found / expected - 1.0).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn planes_are_continued_exactly() {
        let inner = error(&surface(SIZE, plane, 8..24, 6..18));
        let cut_off = error(&surface(SIZE, plane, 8..24, 15..30));
        let corner = error(&surface(SIZE, plane, 24..40, 15..30));
        assert!([inner, cut_off, corner].iter().all(|error| *error <= 1e-5), "{inner}, {cut_off}, {corner}");
    }

    /// The mean of the neighbours of a saddle is its value, so that the exact continuation is known. In a hole of this size,
    /// averages at one size alone would take thousands of passes.
    #[test]
    fn curved_surfaces_are_continued_smoothly() {
        let saddle = |x: f64, y: f64| 0.5 + 0.4 * ((x - 200.0).powi(2) - (y - 200.0).powi(2)) / 40_000.0;
        let found = error(&surface([400, 400], saddle, 80..320, 80..320));
        assert!(found <= 0.02, "{found}");
    }

    #[test]
    fn depth_beyond_the_image_and_unknown_depth_are_ignored() {
        let (mut seen, behind, hole) = surface(SIZE, plane, 0..20, 12..30);
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

    /// A plane that ends at its horizon, which the hole contains, and an unknown sky.
    #[test]
    fn planes_end_at_their_horizon() {
        let (mut seen, _, hole) = surface(SIZE, |_, y| 0.005 + 0.1 * (24.0 - y).max(0.0), 8..24, 10..30);
        seen.depth_view[25 * SIZE[0]..].fill(0.0);
        let found = continued(&seen, &hole);
        assert!(found.depth_view.iter().zip(&hole.inside).all(|(depth, inside)| !inside || *depth > 0.0));
    }
}

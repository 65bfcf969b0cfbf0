//! A camera's lens, and the pinhole that undistortion produces.

mod distortion;

use engine::{Failure, FailureKind};
use glam::DVec2;
use scene::Intrinsics;

pub(crate) use self::distortion::Distortion;

/// Largest zoom for cropping unseen borders, as in COLMAP's undistorter; more would lose three quarters of the image.
const MAX_ZOOM: f64 = 2.0;
/// Bisection steps for the zoom: 40 halvings of [1, `MAX_ZOOM`] reach the rounding of pixel positions.
const ZOOM_STEPS: usize = 40;
/// Rows and columns of the grid on which the interior is checked: finer than any fold of a polynomial of this degree.
const GRID: u32 = 32;
/// Number of pixels of each side of the border that are checked: between them, a lens bends the border by less than 1/100
/// of a pixel.
const BORDER: u32 = 256;

/// The pinhole and the distortion of a real camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lens {
    /// Image size, focal lengths and principal point.
    pub(crate) intrinsics: Intrinsics,
    /// Distortion of the rays.
    pub(crate) distortion: Distortion,
}

impl Lens {
    /// A lens without distortion.
    pub(crate) fn pinhole(intrinsics: Intrinsics) -> Self {
        Self { intrinsics, distortion: Distortion::default() }
    }

    /// The lens for the same images at another size; each axis is scaled separately.
    pub(crate) fn resized(&self, width: u32, height: u32) -> Self {
        Self { intrinsics: self.intrinsics.resized(width, height), ..*self }
    }

    /// Projects a point of the plane z = 1 to a pixel position.
    pub(crate) fn pixel(&self, point: DVec2) -> DVec2 {
        let k = self.intrinsics;
        self.distortion.apply(point) * DVec2::new(k.focal_x, k.focal_y) + DVec2::new(k.center_x, k.center_y)
    }

    /// The pinhole of undistorted images. It keeps the size and the principal point; focal lengths are multiplied by the
    /// smallest factor ≥ 1 for which every pixel centre of the new image is inside the pixel centres of the old one, so
    /// that no pixel is extrapolated. A lens without distortion is returned unchanged; one that maps several rays of the
    /// new image to one pixel is an error.
    pub(crate) fn undistorted(&self) -> Result<Intrinsics, Failure> {
        if self.distortion.is_none() {
            return Ok(self.intrinsics);
        }
        let fold = || {
            let message = format!("lens distortion folds the image over ({})", self.distortion);
            let hint =
                "calibrate again with fewer coefficients, or undistort the images with `colmap image_undistorter`";
            Failure::new(FailureKind::BadInput, message).hint(hint)
        };
        let mut zoom = 1.0;
        for (column, row) in border(&self.intrinsics) {
            zoom = self.zoom_that_sees(column, row, zoom).ok_or_else(fold)?;
        }
        let target = self.zoomed(zoom);
        let sees_border = border(&target).all(|(column, row)| self.sees(plane_point(&target, column, row)));
        if sees_border && self.is_regular_over(&target) { Ok(target) } else { Err(fold()) }
    }

    /// The smallest zoom ≥ `at_least` at which this lens sees a pixel of the pinhole, if there is one.
    fn zoom_that_sees(&self, column: u32, row: u32, at_least: f64) -> Option<f64> {
        let sees = |zoom: f64| self.sees(plane_point(&self.zoomed(zoom), column, row));
        if sees(at_least) {
            return Some(at_least);
        }
        let (mut too_small, mut sufficient) = (at_least, MAX_ZOOM);
        for _ in 0..ZOOM_STEPS {
            let middle = 0.5 * (too_small + sufficient);
            *(if sees(middle) { &mut sufficient } else { &mut too_small }) = middle;
        }
        sees(sufficient).then_some(sufficient)
    }

    fn zoomed(&self, zoom: f64) -> Intrinsics {
        let k = self.intrinsics;
        Intrinsics { focal_x: k.focal_x * zoom, focal_y: k.focal_y * zoom, ..k }
    }

    /// Whether a point of the plane z = 1 falls between pixel centres of the image, where the lens keeps rays in order.
    fn sees(&self, point: DVec2) -> bool {
        let (last_x, last_y) = (f64::from(self.intrinsics.width) - 0.5, f64::from(self.intrinsics.height) - 0.5);
        let pixel = self.pixel(point);
        let inside = (0.5..=last_x).contains(&pixel.x) && (0.5..=last_y).contains(&pixel.y);
        inside && self.distortion.is_regular_at(point)
    }

    /// Whether the lens keeps rays in order on a grid over the pinhole `target`, so that the undistortion is unique.
    fn is_regular_over(&self, target: &Intrinsics) -> bool {
        let is_regular = |column, row| self.distortion.is_regular_at(plane_point(target, column, row));
        spread(GRID, target.height).all(|row| spread(GRID, target.width).all(|column| is_regular(column, row)))
    }
}

/// Pixels on the border of an image, corners included.
fn border(size: &Intrinsics) -> impl Iterator<Item = (u32, u32)> {
    let Intrinsics { width, height, .. } = *size;
    let rows = spread(BORDER, height).flat_map(move |row| [(0, row), (width - 1, row)]);
    rows.chain(spread(BORDER, width).flat_map(move |column| [(column, 0), (column, height - 1)]))
}

/// At most `count` numbers from 0 to `length - 1`, evenly spread, both ends included.
fn spread(count: u32, length: u32) -> impl Iterator<Item = u32> + Clone {
    let (count, last) = (count.min(length), u64::from(length - 1));
    (0..count).map(move |index| (u64::from(index) * last / u64::from(count.max(2) - 1)) as u32)
}

/// The point of the plane z = 1 at the centre of a pixel.
pub(crate) fn plane_point(pinhole: &Intrinsics, column: u32, row: u32) -> DVec2 {
    let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
    (pixel - DVec2::new(pinhole.center_x, pinhole.center_y)) / DVec2::new(pinhole.focal_x, pinhole.focal_y)
}

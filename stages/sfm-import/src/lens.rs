//! Lens distortion: the Brown–Conrady model of OpenCV and COLMAP, and the pinhole that undistortion produces.

use engine::{Failure, FailureKind};
use glam::DVec2;
use scene::Intrinsics;

/// Largest zoom for cropping unseen borders; coefficients that need more do not describe a real lens.
const MAX_ZOOM: f64 = 4.0;
/// Bisection steps for the zoom: 40 halvings of [1, `MAX_ZOOM`] reach the rounding of pixel positions.
const ZOOM_STEPS: usize = 40;

/// Radial (`k1`, `k2`, `k3`) and tangential (`p1`, `p2`) distortion coefficients on the plane z = 1.
///
/// With d = 1 + k1 r² + k2 r⁴ + k3 r⁶: x' = x d + 2 p1 x y + p2 (r² + 2 x²), y' = y d + p1 (r² + 2 y²) + 2 p2 x y
/// (Brown 1966; COLMAP's `OPENCV`, which includes `RADIAL` and `SIMPLE_RADIAL`, has no k3).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Distortion {
    /// Coefficient of r².
    pub(crate) k1: f64,
    /// Coefficient of r⁴.
    pub(crate) k2: f64,
    /// Coefficient of r⁶.
    pub(crate) k3: f64,
    /// First tangential coefficient.
    pub(crate) p1: f64,
    /// Second tangential coefficient.
    pub(crate) p2: f64,
}

/// The pinhole and the distortion of a real camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lens {
    /// Image size, focal lengths and principal point.
    pub(crate) intrinsics: Intrinsics,
    /// Distortion of the rays.
    pub(crate) distortion: Distortion,
}

impl Distortion {
    /// Whether all coefficients are zero.
    pub(crate) fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Distorts a point of the plane z = 1.
    pub(crate) fn apply(&self, point: DVec2) -> DVec2 {
        let Self { k1, k2, k3, p1, p2 } = *self;
        let (r2, xy) = (point.length_squared(), point.x * point.y);
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let tangential = DVec2::new(
            2.0 * p1 * xy + p2 * (r2 + 2.0 * point.x * point.x),
            p1 * (r2 + 2.0 * point.y * point.y) + 2.0 * p2 * xy,
        );
        point * radial + tangential
    }

    /// Whether the radial part increases at squared radius `r2`: d(r + k1 r³ + k2 r⁵ + k3 r⁷)/dr > 0.
    fn grows_at(&self, r2: f64) -> bool {
        1.0 + r2 * (3.0 * self.k1 + r2 * (5.0 * self.k2 + r2 * 7.0 * self.k3)) > 0.0
    }
}

impl Lens {
    /// A lens without distortion.
    pub(crate) fn pinhole(intrinsics: Intrinsics) -> Self {
        Self { intrinsics, distortion: Distortion::default() }
    }

    /// Projects a point of the plane z = 1 to a pixel position.
    pub(crate) fn pixel(&self, point: DVec2) -> DVec2 {
        let k = self.intrinsics;
        self.distortion.apply(point) * DVec2::new(k.focal_x, k.focal_y) + DVec2::new(k.center_x, k.center_y)
    }

    /// The pinhole of undistorted images. It keeps the size and the principal point; focal lengths are multiplied by the
    /// smallest factor ≥ 1 for which every pixel centre of the new image is inside the pixel centres of the old one, so
    /// that no pixel is extrapolated. A lens without distortion is returned unchanged.
    pub(crate) fn undistorted(&self) -> Result<Intrinsics, Failure> {
        if self.distortion.is_none() {
            return Ok(self.intrinsics);
        }
        if !self.sees_border_of(&self.zoomed(MAX_ZOOM)) {
            let Distortion { k1, k2, k3, p1, p2 } = self.distortion;
            let message = format!("lens distortion (k1 {k1}, k2 {k2}, k3 {k3}, p1 {p1}, p2 {p2}) folds the image over");
            let hint = "calibrate again, or undistort the images with `colmap image_undistorter`";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint));
        }
        let (mut too_small, mut sufficient) = (1.0, MAX_ZOOM);
        if self.sees_border_of(&self.zoomed(1.0)) {
            sufficient = 1.0;
        }
        for _ in 0..ZOOM_STEPS {
            let middle = 0.5 * (too_small + sufficient);
            let seen = self.sees_border_of(&self.zoomed(middle));
            *(if seen { &mut sufficient } else { &mut too_small }) = middle;
        }
        Ok(self.zoomed(sufficient))
    }

    fn zoomed(&self, zoom: f64) -> Intrinsics {
        let k = self.intrinsics;
        Intrinsics { focal_x: k.focal_x * zoom, focal_y: k.focal_y * zoom, ..k }
    }

    /// Whether this lens sees every border pixel of the pinhole `target`. The interior follows, because the distortion
    /// increases outwards.
    fn sees_border_of(&self, target: &Intrinsics) -> bool {
        let (width, height) = (target.width, target.height);
        let (last_x, last_y) = (f64::from(width) - 0.5, f64::from(height) - 0.5);
        let rows = (0..height).flat_map(|row| [(0, row), (width - 1, row)]);
        let columns = (0..width).flat_map(|column| [(column, 0), (column, height - 1)]);
        rows.chain(columns).all(|(column, row)| {
            let point = plane_point(target, column, row);
            let pixel = self.pixel(point);
            let inside = (0.5..=last_x).contains(&pixel.x) && (0.5..=last_y).contains(&pixel.y);
            inside && self.distortion.grows_at(point.length_squared())
        })
    }
}

/// The point of the plane z = 1 at the centre of a pixel.
pub(crate) fn plane_point(pinhole: &Intrinsics, column: u32, row: u32) -> DVec2 {
    let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
    (pixel - DVec2::new(pinhole.center_x, pinhole.center_y)) / DVec2::new(pinhole.focal_x, pinhole.focal_y)
}

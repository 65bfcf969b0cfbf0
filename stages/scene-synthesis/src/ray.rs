//! Rays, and their intersection with boxes.

use glam::DVec3;

/// Minimum distance of a hit, in units of the ray direction; a nearer hit is the surface on which the ray starts.
pub(crate) const MIN_DISTANCE: f64 = 1e-7;

/// A ray `origin + s · direction`; the direction need not be a unit vector.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    /// The point at s = 0.
    pub(crate) origin: DVec3,
    /// The offset from s = 0 to s = 1.
    pub(crate) direction: DVec3,
}

impl Ray {
    /// The point at `s`.
    pub(crate) fn at(&self, s: f64) -> DVec3 {
        self.origin + s * self.direction
    }
}

/// Where a ray enters and leaves the box with half edge lengths `half`.
pub(crate) fn slab(ray: &Ray, half: DVec3) -> Option<(f64, f64)> {
    let inverse = ray.direction.recip();
    let (a, b) = ((-half - ray.origin) * inverse, (half - ray.origin) * inverse);
    let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
    (enter <= leave && leave > MIN_DISTANCE).then_some((enter, leave))
}

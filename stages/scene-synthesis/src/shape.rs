//! Solids and their first intersection with a ray, in object coordinates.

use glam::DVec3;

use crate::wave::Wave;

/// Hits nearer than this (in units of the ray's direction) are the surface that the ray starts on.
pub const MIN_DISTANCE: f64 = 1e-7;

/// `origin + s · direction`; the direction need not have length 1.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Where s = 0.
    pub origin: DVec3,
    /// Where s = 1, relative to the origin.
    pub direction: DVec3,
}

/// The surface of a body.
#[derive(Clone, Debug)]
pub enum Shape {
    /// About the origin; seen from inside as well.
    Sphere {
        /// In scene units.
        radius: f64,
    },
    /// Axis-aligned about the origin.
    Block {
        /// Half the edges.
        half: DVec3,
    },
    /// Points within `radius` of the segment from the origin to (0, 0, length).
    Capsule {
        /// Of the segment.
        length: f64,
        /// In scene units.
        radius: f64,
    },
    /// A sheet z = h(x, y, time).
    Cloth(Wave),
}

impl Ray {
    /// The point at `s`.
    pub fn at(&self, s: f64) -> DVec3 {
        self.origin + s * self.direction
    }
}

impl Shape {
    /// Smallest s > 0 on the surface, and the unit normal there (outwards, or either side of a sheet).
    pub fn hit(&self, ray: &Ray, time_secs: f64) -> Option<(f64, DVec3)> {
        match self {
            Self::Sphere { radius } => {
                let s = sphere(ray, DVec3::ZERO, *radius)?;
                Some((s, ray.at(s) / *radius))
            }
            Self::Block { half } => block(ray, *half),
            Self::Capsule { length, radius } => capsule(ray, *length, *radius),
            Self::Cloth(wave) => wave.hit(ray, time_secs),
        }
    }

    /// Where the material point that was hit at `material` is at another time.
    pub fn position(&self, material: DVec3, time_secs: f64) -> DVec3 {
        match self {
            Self::Cloth(wave) => material.with_z(wave.height(material.x, material.y, time_secs).value),
            _ => material,
        }
    }

    /// The velocity of a material point within the object's frame.
    pub fn velocity(&self, material: DVec3, time_secs: f64) -> DVec3 {
        match self {
            Self::Cloth(wave) => DVec3::Z * wave.height(material.x, material.y, time_secs).rate,
            _ => DVec3::ZERO,
        }
    }

    /// Centre and radius of a sphere around the shape at all times.
    pub fn bounding_sphere(&self) -> (DVec3, f64) {
        match self {
            Self::Sphere { radius } => (DVec3::ZERO, *radius),
            Self::Block { half } => (DVec3::ZERO, half.length()),
            Self::Capsule { length, radius } => (0.5 * length * DVec3::Z, 0.5 * length + radius),
            Self::Cloth(wave) => (DVec3::ZERO, wave.half_box().length()),
        }
    }
}

/// First positive root of `|origin + s · direction - center| = radius`.
pub fn sphere(ray: &Ray, center: DVec3, radius: f64) -> Option<f64> {
    let offset = ray.origin - center;
    let a = ray.direction.length_squared();
    let half_b = offset.dot(ray.direction);
    let discriminant = half_b * half_b - a * (offset.length_squared() - radius * radius);
    if !(discriminant >= 0.0) {
        return None;
    }
    let root = discriminant.sqrt();
    [(-half_b - root) / a, (-half_b + root) / a].into_iter().find(|s| *s > MIN_DISTANCE)
}

/// Entry and exit of a ray through the box of half edges `half`.
pub fn slab(ray: &Ray, half: DVec3) -> Option<(f64, f64)> {
    let inverse = ray.direction.recip();
    let (a, b) = ((-half - ray.origin) * inverse, (half - ray.origin) * inverse);
    let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
    (enter <= leave && leave > MIN_DISTANCE).then_some((enter, leave))
}

fn block(ray: &Ray, half: DVec3) -> Option<(f64, DVec3)> {
    let (enter, leave) = slab(ray, half)?;
    let s = if enter > MIN_DISTANCE { enter } else { leave };
    // The face that was hit is the one whose coordinate is relatively largest.
    let relative = ray.at(s) / half;
    let size = relative.abs();
    let axis = if size.x >= size.y && size.x >= size.z {
        DVec3::X
    } else if size.y >= size.z {
        DVec3::Y
    } else {
        DVec3::Z
    };
    Some((s, axis * relative.dot(axis).signum()))
}

/// The nearest of the two caps and the cylinder between them (for rays from outside).
fn capsule(ray: &Ray, length: f64, radius: f64) -> Option<(f64, DVec3)> {
    let caps = [sphere(ray, DVec3::ZERO, radius), sphere(ray, length * DVec3::Z, radius)];
    let s = caps.into_iter().chain([cylinder(ray, length, radius)]).flatten().reduce(f64::min)?;
    let point = ray.at(s);
    let nearest = DVec3::Z * point.z.clamp(0.0, length);
    Some((s, (point - nearest).normalize()))
}

/// First intersection with the side of a cylinder about z, between z = 0 and z = length.
fn cylinder(ray: &Ray, length: f64, radius: f64) -> Option<f64> {
    let (origin, direction) = (ray.origin.truncate(), ray.direction.truncate());
    let a = direction.length_squared();
    let half_b = origin.dot(direction);
    let discriminant = half_b * half_b - a * (origin.length_squared() - radius * radius);
    // A ray along the axis has a = 0 and meets the caps only: its s is not finite.
    let s = (-half_b - discriminant.sqrt()) / a;
    (s > MIN_DISTANCE && (0.0..=length).contains(&ray.at(s).z)).then_some(s)
}

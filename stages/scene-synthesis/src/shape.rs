//! Shapes and their first intersection with a ray, in object coordinates.

use glam::DVec3;

use crate::ray::{MIN_DISTANCE, Ray, slab};
use crate::wave::Wave;

/// The surface of a body.
#[derive(Clone, Debug)]
pub(crate) enum Shape {
    /// A sphere around the origin, visible from inside too.
    Sphere {
        /// Radius in scene units.
        radius: f64,
    },
    /// An axis-aligned box around the origin.
    Block {
        /// Half the edge lengths.
        half: DVec3,
    },
    /// All points within `radius` of the segment from the origin to (0, 0, length).
    Capsule {
        /// Length of the segment.
        length: f64,
        /// Radius in scene units.
        radius: f64,
    },
    /// A sheet z = h(x, y, time).
    Cloth(Wave),
}

impl Shape {
    /// The first hit: s > 0 and the unit normal, which points outwards, or to either side of a sheet.
    pub(crate) fn hit(&self, ray: &Ray, time_secs: f64) -> Option<(f64, DVec3)> {
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

    /// The position of a material point at a time, in object coordinates.
    pub(crate) fn position(&self, material: DVec3, time_secs: f64) -> DVec3 {
        match self {
            Self::Cloth(wave) => material.with_z(wave.height(material.x, material.y, time_secs).value),
            _ => material,
        }
    }

    /// The velocity of a material point relative to the object's frame.
    pub(crate) fn velocity(&self, material: DVec3, time_secs: f64) -> DVec3 {
        match self {
            Self::Cloth(wave) => DVec3::Z * wave.height(material.x, material.y, time_secs).rate,
            _ => DVec3::ZERO,
        }
    }

    /// Centre and radius of a sphere that contains the shape at all times.
    pub(crate) fn bounding_sphere(&self) -> (DVec3, f64) {
        match self {
            Self::Sphere { radius } => (DVec3::ZERO, *radius),
            Self::Block { half } => (DVec3::ZERO, half.length()),
            Self::Capsule { length, radius } => (0.5 * length * DVec3::Z, 0.5 * length + radius),
            Self::Cloth(wave) => (DVec3::ZERO, wave.half_box().length()),
        }
    }
}

/// The first positive root of `|origin + s · direction - center| = radius`.
fn sphere(ray: &Ray, center: DVec3, radius: f64) -> Option<f64> {
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

/// The first hit of a box.
fn block(ray: &Ray, half: DVec3) -> Option<(f64, DVec3)> {
    let (enter, leave) = slab(ray, half)?;
    let s = if enter > MIN_DISTANCE { enter } else { leave };
    // The hit face belongs to the coordinate that is largest relative to its half edge.
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

/// The first hit of a capsule from outside: the nearest of its two caps and the cylinder between them.
fn capsule(ray: &Ray, length: f64, radius: f64) -> Option<(f64, DVec3)> {
    let caps = [sphere(ray, DVec3::ZERO, radius), sphere(ray, length * DVec3::Z, radius)];
    let s = caps.into_iter().chain([cylinder(ray, length, radius)]).flatten().reduce(f64::min)?;
    let point = ray.at(s);
    let nearest = DVec3::Z * point.z.clamp(0.0, length);
    Some((s, (point - nearest).normalize()))
}

/// The first intersection with the side of a cylinder around the z axis, between z = 0 and z = length.
fn cylinder(ray: &Ray, length: f64, radius: f64) -> Option<f64> {
    let (origin, direction) = (ray.origin.truncate(), ray.direction.truncate());
    let a = direction.length_squared();
    let half_b = origin.dot(direction);
    let discriminant = half_b * half_b - a * (origin.length_squared() - radius * radius);
    // A ray along the axis has a = 0 and thus no finite s; it meets the caps only.
    let s = (-half_b - discriminant.sqrt()) / a;
    (s > MIN_DISTANCE && (0.0..=length).contains(&ray.at(s).z)).then_some(s)
}

//! A waving sheet, held along one edge by a rod between two posts.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DMat3, DVec2, DVec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use scene::RigidTransform;

use super::floor;
use crate::placement::Placement;
use crate::shape::Shape;
use crate::texture::{Pattern, Texture};
use crate::wave::Wave;
use crate::world::{Body, World};

/// Downward inclination of the sheet, away from the rod, in radians.
const SLOPE: f64 = 0.45;

/// Builds the scene; the seed draws the phase.
pub(crate) fn build(random: &mut ChaCha8Rng) -> World {
    let half = DVec2::new(0.85, 0.75);
    let wave = Wave::new(half, 0.24, random.random_range(0.0..TAU));
    // The x axis of the sheet points away from the rod and downwards.
    let rotation = DMat3::from_rotation_y(SLOPE);
    let center = DVec3::new(0.1, 0.0, 0.05);
    let world_from_sheet = RigidTransform { rotation, translation: center };
    let sheet = Body {
        label: 1,
        shape: Shape::Cloth(wave),
        texture: Texture::new(Pattern::Checker, 4.0, [0xa3243b, 0xf3e3c3]),
        motion: Box::new(move |_| Placement { world_from_object: world_from_sheet, ..Placement::resting(center) }),
    };
    let wood = Texture::new(Pattern::Stripes, 2.0, [0x5b3d22, 0xa37a4c]);
    let edge = world_from_sheet.apply(DVec3::new(-half.x, 0.0, 0.0));
    let rod =
        RigidTransform { rotation: DMat3::from_rotation_x(-FRAC_PI_2), translation: edge - (half.y + 0.05) * DVec3::Y };
    let rod = Body {
        label: 0,
        shape: Shape::Capsule { length: 2.0 * (half.y + 0.05), radius: 0.045 },
        texture: wood,
        motion: Box::new(move |_| Placement { world_from_object: rod, ..Placement::resting(rod.translation) }),
    };
    let post = |side: f64| {
        let foot = DVec3::new(edge.x, side * (half.y + 0.05), -0.78);
        Body::resting(Shape::Capsule { length: edge.z - foot.z, radius: 0.05 }, wood, foot)
    };
    let ground = floor(0.95, -0.78, Texture::new(Pattern::Noise, 5.0, [0x6d7f52, 0xb7c08c]));
    let bodies = vec![ground, post(-1.0), post(1.0), rod, sheet];
    World {
        bodies,
        class_names: vec!["cloth".into()],
        center_world: DVec3::new(0.0, 0.0, -0.25),
        bounds_world: [[-1.05, -1.0, -0.85], [1.1, 1.0, 0.85]],
    }
}

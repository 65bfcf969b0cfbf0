//! Static blocks, a ball and a column on a floor.

use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::floor;
use crate::shape::Shape;
use crate::texture::{Pattern, Texture};
use crate::world::{Body, World};

const FLOOR_TOP: f64 = -0.6;

/// Builds the scene; the seed shifts the blocks.
pub(crate) fn build(random: &mut ChaCha8Rng) -> World {
    let mut bodies = vec![floor(0.95, FLOOR_TOP, Texture::new(Pattern::Checker, 2.5, [0x8f8a80, 0xd9d3c7]))];
    let blocks = [
        ([-0.5, -0.45], [0.25, 0.22, 0.30], Pattern::Checker, 5.0, [0xb5412b, 0xf2d5a0]),
        ([0.5, -0.4], [0.18, 0.28, 0.45], Pattern::Stripes, 2.5, [0x23527c, 0xe3edf5]),
        ([-0.45, 0.45], [0.22, 0.22, 0.60], Pattern::Noise, 7.0, [0x2e6b34, 0xd9e27a]),
    ];
    for ([x, y], half, pattern, frequency, colors) in blocks {
        let half = DVec3::from(half);
        let nudge = DVec3::new(random.random_range(-0.05..0.05), random.random_range(-0.05..0.05), 0.0);
        let position = DVec3::new(x, y, FLOOR_TOP + half.z) + nudge;
        bodies.push(Body::resting(Shape::Block { half }, Texture::new(pattern, frequency, colors), position));
    }
    let ball = Texture::new(Pattern::Checker, 4.0, [0x6b2a7a, 0xf3c1dd]);
    bodies.push(Body::resting(Shape::Sphere { radius: 0.3 }, ball, DVec3::new(0.45, 0.45, FLOOR_TOP + 0.3)));
    let column = Texture::new(Pattern::Noise, 8.0, [0x7a5a12, 0xf5d76e]);
    let column_shape = Shape::Capsule { length: 0.75, radius: 0.13 };
    bodies.push(Body::resting(column_shape, column, DVec3::new(0.0, 0.0, FLOOR_TOP)));
    World {
        bodies,
        class_names: Vec::new(),
        center_world: DVec3::new(0.0, 0.0, -0.2),
        bounds_world: [[-1.0, -1.0, -0.68], [1.0, 1.0, 0.65]],
    }
}

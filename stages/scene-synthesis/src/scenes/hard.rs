//! Scenes built to break methods: each has one property that challenges arithmetic, sampling or motion models.

use std::f64::consts::TAU;

use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::floor;
use crate::placement::{Angle, Placement};
use crate::shape::Shape;
use crate::texture::{Pattern, Texture};
use crate::world::{Body, World};

const FLOOR_TOP: f64 = -0.6;
/// Time in seconds between two jumps of the teleporting ball.
const JUMP_SECS: f64 = 0.2;
/// Radius of a thin needle: about a hundredth of a pixel in an image of 64 pixels.
const NEEDLE_RADIUS: f64 = 0.0002;
/// Radius of the speck: less than half a pixel in an image of 64 pixels.
const SPECK_RADIUS: f64 = 0.02;
/// Radius of the small bodies.
const SMALL_RADIUS: f64 = 0.17;

/// A checker texture.
fn checker(frequency: f64, colors: [u32; 2]) -> Texture {
    Texture::new(Pattern::Checker, frequency, colors)
}

/// A moving ball with label 1.
fn ball(radius: f64, texture: Texture, motion: impl Fn(f64) -> Placement + Send + Sync + 'static) -> Body {
    Body { label: 1, shape: Shape::Sphere { radius }, texture, motion: Box::new(motion) }
}

/// The floor.
fn plate() -> Body {
    floor(0.95, FLOOR_TOP, checker(2.5, [0x8f8a80, 0xd9d3c7]))
}

/// A world around the origin with one moving instance.
fn world(bodies: Vec<Body>, name: &str, reach: f64) -> World {
    World {
        bodies,
        class_names: vec![name.to_owned()],
        center_world: DVec3::ZERO,
        bounds_world: [[-reach; 3], [reach; 3]],
    }
}

/// A ball that flies through the start position of an arc camera: in front of, through and behind its near plane.
pub(crate) fn near_flyby(random: &mut ChaCha8Rng) -> World {
    let towards_camera = DVec3::new(0.0, -0.83, 0.55).normalize();
    let phase = random.random_range(0.0..0.1);
    let flying = ball(0.25, checker(4.0, [0xc4262e, 0xf7e7a9]), move |time_secs| {
        let along = Angle::swinging(2.4, 2.4, 1.0, phase, time_secs);
        Placement::moving(along.value * towards_camera, along.rate * towards_camera)
    });
    world(vec![plate(), flying], "ball", 1.3)
}

/// Swinging needles, far thinner than a pixel and longer than half the image.
pub(crate) fn needles(random: &mut ChaCha8Rng) -> World {
    let mut bodies = vec![plate()];
    for index in 0..7 {
        let color = [0xb5412b, 0x23527c, 0x2e6b34, 0x6b2a7a][index % 4];
        let position = DVec3::new(0.25 * index as f64 - 0.75, 0.2 * (index % 3) as f64 - 0.2, -0.55);
        let (phase, rate) = (random.random_range(0.0..3.0), 0.5 + 0.4 * index as f64);
        // Every other needle is thicker, so that some of them are visible.
        let radius = if index % 2 == 0 { 60.0 * NEEDLE_RADIUS } else { NEEDLE_RADIUS };
        bodies.push(Body {
            label: 1,
            shape: Shape::Capsule { length: 1.3, radius },
            texture: Texture::new(Pattern::Stripes, 8.0, [color, 0xf0e8d0]),
            motion: Box::new(move |time_secs| {
                let lean = Angle::swinging(0.0, 0.6, 1.0 / rate, phase, time_secs);
                Placement::resting(position).joint(DVec3::ZERO, DVec3::X, lean)
            }),
        });
    }
    world(bodies, "needles", 1.0)
}

/// A ball that rests and jumps every fifth of a second: motion without velocity.
pub(crate) fn teleport(random: &mut ChaCha8Rng) -> World {
    let turn = random.random_range(0.0..1.0);
    let jumping = ball(0.28, checker(4.0, [0x1f4fa3, 0xe9eef7]), move |time_secs| {
        // The offset puts a frame at the time of a jump after the jump, for any rounding of its time.
        let jumps = ((time_secs + 1e-9) / JUMP_SECS).floor();
        let angle = turn + 2.4 * jumps;
        Placement::resting(DVec3::new(0.6 * angle.cos(), 0.6 * angle.sin(), 0.3 * (jumps % 3.0) - 0.3))
    });
    world(vec![plate(), jumping], "ball", 1.0)
}

/// A ball so small that it covers one pixel of most images, and none of some.
pub(crate) fn speck(random: &mut ChaCha8Rng) -> World {
    let phase = random.random_range(0.0..1.0);
    let flying = ball(SPECK_RADIUS, checker(1.0, [0x202020, 0x303030]), move |time_secs| {
        let along = Angle::swinging(0.0, 0.7, 1.5, phase, time_secs);
        Placement::moving(DVec3::new(along.value, 0.0, 0.2), along.rate * DVec3::X)
    });
    world(vec![flying], "speck", 0.8)
}

/// Three balls that cover three to four per cent of an image: one rests, two swing. Like objects on a white floor in
/// front of white, they leave most of every image equal to the background.
pub(crate) fn small_bodies(random: &mut ChaCha8Rng) -> World {
    let mut swinging = |center: DVec3, along: DVec3, colors: [u32; 2]| {
        let phase = random.random_range(0.0..TAU);
        ball(SMALL_RADIUS, checker(4.0, colors), move |time_secs| {
            let Angle { value, rate } = Angle::swinging(0.0, 0.3, 1.2, phase, time_secs);
            Placement::moving(center + value * along, rate * along)
        })
    };
    let left = swinging(DVec3::new(-0.55, -0.2, 0.1), DVec3::Y, [0xb3202a, 0x5a1015]);
    let right = swinging(DVec3::new(0.6, 0.25, -0.2), DVec3::Z, [0x1f4fa3, 0x10264f]);
    let still = Shape::Sphere { radius: SMALL_RADIUS };
    let still = Body::resting(still, checker(4.0, [0x0e6b3a, 0x07351d]), DVec3::new(0.05, -0.5, -0.3));
    world(vec![left, right, still], "balls", 0.8)
}

/// A black ball above a black floor: on a black background, images have no signal.
pub(crate) fn black(random: &mut ChaCha8Rng) -> World {
    let black = || checker(1.0, [0x000000, 0x000000]);
    let phase = random.random_range(0.0..1.0);
    let moving = ball(0.3, black(), move |time_secs| {
        let along = Angle::swinging(0.0, 0.6, 1.5, phase, time_secs);
        Placement::moving(along.value * DVec3::X, along.rate * DVec3::X)
    });
    world(vec![floor(0.95, FLOOR_TOP, black()), moving], "ball", 1.0)
}

/// A ball that moves below the floor, where no camera sees it, so that every mask is empty.
pub(crate) fn unseen_motion(random: &mut ChaCha8Rng) -> World {
    let phase = random.random_range(0.0..1.0);
    let hidden = ball(0.1, checker(4.0, [0x0e6b3a, 0xd8e86a]), move |time_secs| {
        let along = Angle::swinging(0.0, 0.3, 1.0, phase, time_secs);
        Placement::moving(DVec3::new(along.value, 0.0, FLOOR_TOP - 0.2), along.rate * DVec3::X)
    });
    let block = DVec3::new(0.3, 0.2, 0.35);
    let mark = Body::resting(
        Shape::Block { half: block },
        checker(5.0, [0xb5412b, 0xf2d5a0]),
        DVec3::new(0.2, 0.1, FLOOR_TOP + block.z),
    );
    world(vec![plate(), mark, hidden], "ball", 1.0)
}

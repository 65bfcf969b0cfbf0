//! A ball that rolls along a floor, through a tunnel that hides it, and back.

use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::floor;
use crate::placement::{Angle, Placement};
use crate::shape::Shape;
use crate::texture::{Pattern, Texture};
use crate::world::{Body, World};

const FLOOR_TOP: f64 = -0.45;
const RADIUS: f64 = 0.24;
/// The centre of the ball swings between x = -reach and x = reach.
const REACH: f64 = 0.95;
/// Time in seconds of one round trip.
const PERIOD_SECS: f64 = 2.0;
/// Half the length of the tunnel, which is long enough to hide the ball.
const TUNNEL_HALF: f64 = 0.42;

/// Half the length of the tunnel that hides the ball for two thirds of the time.
const LONG_TUNNEL_HALF: f64 = 0.85;
const LONG_REACH: f64 = 1.15;

/// The scene with the short tunnel.
pub(crate) fn build(random: &mut ChaCha8Rng) -> World {
    with_tunnel(random, TUNNEL_HALF, REACH)
}

/// The scene with a tunnel that hides the ball most of the time.
pub(crate) fn build_long(random: &mut ChaCha8Rng) -> World {
    with_tunnel(random, LONG_TUNNEL_HALF, LONG_REACH)
}

/// The scene with a tunnel of the given half length, and a ball with the given reach.
fn with_tunnel(random: &mut ChaCha8Rng, tunnel_half: f64, reach: f64) -> World {
    let ball = Body {
        label: 1,
        shape: Shape::Sphere { radius: RADIUS },
        texture: Texture::new(Pattern::Checker, 4.5, [0xc4262e, 0xf7e7a9]),
        motion: Box::new(move |time_secs| rolling(reach, time_secs)),
    };
    let stone = |color: u32| Texture::new(Pattern::Noise, 6.0, [color, 0xc7bca8]);
    let (inner, wall, roof) = (RADIUS + 0.05, 0.06, 0.06);
    let wall_half = DVec3::new(tunnel_half, 0.5 * wall, inner);
    let wall_body = |side: f64, color: u32| {
        let position = DVec3::new(0.0, side * (inner + 0.5 * wall), FLOOR_TOP + inner);
        Body::resting(Shape::Block { half: wall_half }, stone(color), position)
    };
    let roof_half = DVec3::new(tunnel_half, inner + wall, 0.5 * roof);
    let roof_position = DVec3::new(0.0, 0.0, FLOOR_TOP + 2.0 * inner + 0.5 * roof);
    let roof_body = Body::resting(Shape::Block { half: roof_half }, stone(0x3d6b57), roof_position);
    // A landmark at a random position, which breaks the symmetry.
    let mark = DVec3::new(random.random_range(-0.8..-0.5), 0.46, FLOOR_TOP + 0.16);
    let mark_texture = Texture::new(Pattern::Checker, 5.0, [0x22577a, 0xdce9f0]);
    let mark_body = Body::resting(Shape::Block { half: DVec3::new(0.11, 0.11, 0.16) }, mark_texture, mark);
    let ground = Texture::new(Pattern::Checker, 2.0, [0xa59a86, 0xdcd3c1]);
    let mut plate = floor(1.0, FLOOR_TOP, ground);
    plate.shape = Shape::Block { half: DVec3::new(reach + 0.27, 0.62, 0.03) };
    let bodies = vec![plate, wall_body(-1.0, 0x5b4a3f), wall_body(1.0, 0x44546a), roof_body, mark_body, ball];
    World {
        bodies,
        class_names: vec!["ball".into()],
        center_world: DVec3::new(0.0, 0.0, -0.3),
        bounds_world: [[-reach - 0.3, -0.65, -0.52], [reach + 0.3, 0.65, 0.25]],
    }
}

/// Rolling along x without slipping.
fn rolling(reach: f64, time_secs: f64) -> Placement {
    let along = Angle::swinging(0.0, reach, PERIOD_SECS, std::f64::consts::FRAC_PI_2, time_secs);
    let position = DVec3::new(along.value, 0.0, FLOOR_TOP + RADIUS);
    let roll = Angle { value: along.value / RADIUS, rate: along.rate / RADIUS };
    Placement::moving(position, along.rate * DVec3::X).joint(DVec3::ZERO, DVec3::Y, roll)
}

//! Four balls, each bouncing between two spots of a floor without losing energy.

use glam::{DVec2, DVec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::floor;
use crate::placement::{Angle, Placement};
use crate::shape::Shape;
use crate::texture::{Pattern, Texture};
use crate::world::{Body, World};

/// Gravity in scene units per second²: a bounce of height 0.8 takes one second.
const GRAVITY: f64 = 6.4;
const FLOOR_TOP: f64 = -0.75;

/// The trajectory of a ball.
#[derive(Clone, Copy)]
struct Hops {
    spots: [DVec2; 2],
    radius: f64,
    height: f64,
    /// Number of bounces, with a fraction, at time 0.
    phase: f64,
    spin: f64,
}

/// Builds the scene; the seed draws phases and spins.
pub(crate) fn build(random: &mut ChaCha8Rng) -> World {
    let balls = [
        ("red ball", [[-0.60, -0.65], [-0.60, -0.20]], 0.26, 1.00, Pattern::Checker, 4.5, [0xb3202a, 0xf4d9c6]),
        ("blue ball", [[0.55, -0.55], [0.10, -0.55]], 0.22, 0.70, Pattern::Stripes, 3.0, [0x1f4fa3, 0xe9eef7]),
        ("green ball", [[0.60, 0.10], [0.60, 0.65]], 0.24, 0.85, Pattern::Noise, 6.0, [0x0e6b3a, 0xd8e86a]),
        ("orange ball", [[-0.55, 0.60], [-0.05, 0.45]], 0.30, 0.50, Pattern::Checker, 3.6, [0xd9741c, 0x3c2a6b]),
    ];
    let texture = Texture::new(Pattern::Checker, 2.5, [0x9a9690, 0xd6d0c4]);
    let mut bodies = vec![floor(0.95, FLOOR_TOP, texture)];
    let mut class_names = Vec::new();
    for (name, spots, radius, height, pattern, frequency, colors) in balls {
        class_names.push(name.to_owned());
        let spots = spots.map(DVec2::from);
        let hops = Hops { spots, radius, height, phase: random.random::<f64>(), spin: random.random_range(1.5..3.5) };
        bodies.push(Body {
            label: class_names.len() as u8,
            shape: Shape::Sphere { radius },
            texture: Texture::new(pattern, frequency, colors),
            motion: Box::new(move |time_secs| hops.at(time_secs)),
        });
    }
    World {
        bodies,
        class_names,
        center_world: DVec3::new(0.0, 0.0, -0.25),
        bounds_world: [[-1.0, -1.0, -0.82], [1.0, 1.0, 0.8]],
    }
}

impl Hops {
    /// Placement at a time: free fall between bounces; the horizontal velocity is reversed at each bounce.
    fn at(&self, time_secs: f64) -> Placement {
        let start_speed = (2.0 * GRAVITY * self.height).sqrt();
        let hop_secs = 2.0 * start_speed / GRAVITY;
        let hops = time_secs / hop_secs + self.phase;
        let (since_bounce_secs, share) = (hops.fract() * hop_secs, hops.fract());
        let [from, to] = if hops.floor() % 2.0 == 0.0 { self.spots } else { [self.spots[1], self.spots[0]] };
        let rise = start_speed * since_bounce_secs - 0.5 * GRAVITY * since_bounce_secs.powi(2);
        let position = from.lerp(to, share).extend(FLOOR_TOP + self.radius + rise);
        let velocity = ((to - from) / hop_secs).extend(start_speed - GRAVITY * since_bounce_secs);
        let axis = DVec3::new(0.6, 0.64, 0.48);
        Placement::moving(position, velocity).joint(DVec3::ZERO, axis, Angle::turning(self.spin, time_secs))
    }
}

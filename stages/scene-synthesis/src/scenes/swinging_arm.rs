//! An arm of three links on a turning pedestal, with sinusoidal joint angles.

use std::f64::consts::TAU;

use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::floor;
use crate::placement::{Angle, Placement};
use crate::shape::Shape;
use crate::texture::{Pattern, Texture};
use crate::world::{Body, World};

const SHOULDER: DVec3 = DVec3::new(0.0, 0.0, -0.42);

/// One joint with its link: a rotation about an axis at the end of the previous link.
#[derive(Clone, Copy)]
struct Link {
    length: f64,
    axis: DVec3,
    mean: f64,
    amplitude: f64,
    period_secs: f64,
    phase: f64,
}

/// Builds the scene; the seed draws the phases.
pub(crate) fn build(random: &mut ChaCha8Rng) -> World {
    let mut link = |length, axis, mean, amplitude, period_secs| {
        let phase = random.random_range(0.0..TAU);
        Link { length, axis, mean, amplitude, period_secs, phase }
    };
    let chain = [
        link(0.0, DVec3::Z, 0.0, 0.9, 3.1),
        link(0.62, DVec3::Y, 0.15, 0.55, 1.9),
        link(0.50, DVec3::Y, 0.5, 0.8, 1.4),
        link(0.34, DVec3::X, 0.3, 0.9, 1.1),
    ];
    let texture = Texture::new(Pattern::Checker, 2.5, [0x8d9aa3, 0xcfd6d8]);
    let pedestal = Texture::new(Pattern::Noise, 9.0, [0x3b3f45, 0x8b9097]);
    let foot = DVec3::new(0.0, 0.0, -0.74);
    let mut bodies =
        vec![floor(0.9, -0.75, texture), Body::resting(Shape::Capsule { length: 0.28, radius: 0.24 }, pedestal, foot)];
    let looks = [
        (0.17, Texture::new(Pattern::Stripes, 2.4, [0xc8451b, 0xf5c33b])),
        (0.145, Texture::new(Pattern::Checker, 5.0, [0x1d5c8a, 0xe6eff5])),
        (0.12, Texture::new(Pattern::Noise, 8.0, [0x6a1b7a, 0xf0a6c8])),
    ];
    for (index, (radius, texture)) in looks.into_iter().enumerate() {
        let count = index + 2;
        bodies.push(Body {
            label: 1,
            shape: Shape::Capsule { length: chain[index + 1].length, radius },
            texture,
            motion: Box::new(move |time_secs| placement(&chain[..count], time_secs)),
        });
    }
    World {
        bodies,
        class_names: vec!["arm".into()],
        center_world: DVec3::new(0.0, 0.0, -0.1),
        bounds_world: [[-1.3, -1.3, -0.82], [1.3, 1.3, 1.2]],
    }
}

/// Placement of the last link of a chain.
fn placement(chain: &[Link], time_secs: f64) -> Placement {
    let mut placement = Placement::resting(SHOULDER);
    let mut offset = DVec3::ZERO;
    for link in chain {
        let angle = Angle::swinging(link.mean, link.amplitude, link.period_secs, link.phase, time_secs);
        placement = placement.joint(offset, link.axis, angle);
        offset = link.length * DVec3::Z;
    }
    placement
}

//! The scenes: each function builds one world, about 2.6 units wide and centred at the origin, with z upwards.

mod bouncing_spheres;
mod hard;
mod occluder;
mod static_blocks;
mod swinging_arm;
mod waving_cloth;

use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::params::{Background, Params, SceneKind};
use crate::placement::Placement;
use crate::shape::Shape;
use crate::texture::{Pattern, Texture};
use crate::world::{Body, DOME_RADIUS, World};

/// Builds the world of the given parameters.
pub(crate) fn build(params: &Params) -> World {
    let mut random = ChaCha8Rng::seed_from_u64(params.seed);
    let mut world = match params.scene {
        SceneKind::BouncingSpheres => bouncing_spheres::build(&mut random),
        SceneKind::SwingingArm => swinging_arm::build(&mut random),
        SceneKind::WavingCloth => waving_cloth::build(&mut random),
        SceneKind::Occluder => occluder::build(&mut random),
        SceneKind::StaticBlocks => static_blocks::build(&mut random),
        SceneKind::NearFlyby => hard::near_flyby(&mut random),
        SceneKind::Needles => hard::needles(&mut random),
        SceneKind::Teleport => hard::teleport(&mut random),
        SceneKind::LongOcclusion => occluder::build_long(&mut random),
        SceneKind::Speck => hard::speck(&mut random),
        SceneKind::SmallBodies => hard::small_bodies(&mut random),
        SceneKind::Black => hard::black(&mut random),
        SceneKind::UnseenMotion => hard::unseen_motion(&mut random),
    };
    if params.background == Background::None {
        let texture = Texture::new(Pattern::Noise, 0.6, [0x6f87a5, 0xc9d4dc]);
        world.bodies.push(Body::resting(Shape::Sphere { radius: DOME_RADIUS }, texture, DVec3::ZERO));
        world.bounds_world = [[-DOME_RADIUS; 3], [DOME_RADIUS; 3]];
    }
    moved(world, DVec3::from(params.origin_world))
}

/// Translates a world.
fn moved(mut world: World, origin: DVec3) -> World {
    for body in &mut world.bodies {
        let motion = std::mem::replace(&mut body.motion, Box::new(|_| Placement::resting(DVec3::ZERO)));
        body.motion = Box::new(move |time_secs| motion(time_secs).translated(origin));
    }
    world.center_world += origin;
    world.bounds_world = world.bounds_world.map(|corner| (DVec3::from(corner) + origin).to_array());
    world
}

/// A square plate whose upper face is at height `top`.
fn floor(half_width: f64, top: f64, texture: Texture) -> Body {
    let half = DVec3::new(half_width, half_width, 0.03);
    Body::resting(Shape::Block { half }, texture, DVec3::new(0.0, 0.0, top - half.z))
}

//! Pose and velocity of a rigid body at one instant.

use glam::{DMat3, DVec3};
use scene::RigidTransform;

/// A pose with its exact time derivative.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    /// Transform from object to world coordinates.
    pub(crate) world_from_object: RigidTransform,
    /// Velocity of the object's origin, world, in scene units per second.
    pub(crate) linear_velocity: DVec3,
    /// Angular velocity, world, in radians per second.
    pub(crate) angular_velocity: DVec3,
}

/// An angle with its time derivative.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Angle {
    /// The angle in radians.
    pub(crate) value: f64,
    /// Its time derivative in radians per second.
    pub(crate) rate: f64,
}

impl Angle {
    /// A sinusoidal swing: `mean + amplitude · sin(2π · time / period + phase)`.
    pub(crate) fn swinging(mean: f64, amplitude: f64, period_secs: f64, phase: f64, time_secs: f64) -> Self {
        let pulsation = std::f64::consts::TAU / period_secs;
        let argument = pulsation * time_secs + phase;
        Self { value: mean + amplitude * argument.sin(), rate: amplitude * pulsation * argument.cos() }
    }

    /// A uniform turn: `rate · time`.
    pub(crate) fn turning(rate: f64, time_secs: f64) -> Self {
        Self { value: rate * time_secs, rate }
    }
}

impl Placement {
    /// A static body at a position, without rotation.
    pub(crate) fn resting(position: DVec3) -> Self {
        Self::moving(position, DVec3::ZERO)
    }

    /// A translating body, without rotation.
    pub(crate) fn moving(position: DVec3, velocity: DVec3) -> Self {
        let world_from_object = RigidTransform { rotation: DMat3::IDENTITY, translation: position };
        Self { world_from_object, linear_velocity: velocity, angular_velocity: DVec3::ZERO }
    }

    /// A child body, attached at `offset` and rotated by `angle` about the unit vector `axis`, both in coordinates of
    /// this body.
    pub(crate) fn joint(&self, offset: DVec3, axis: DVec3, angle: Angle) -> Self {
        let RigidTransform { rotation, .. } = self.world_from_object;
        let world_from_object = RigidTransform {
            rotation: rotation * DMat3::from_axis_angle(axis, angle.value),
            translation: self.world_from_object.apply(offset),
        };
        Self {
            world_from_object,
            linear_velocity: self.velocity(world_from_object.translation),
            angular_velocity: self.angular_velocity + rotation * axis * angle.rate,
        }
    }

    /// Translates the pose by a world offset; velocities do not change.
    pub(crate) fn translated(mut self, offset: DVec3) -> Self {
        self.world_from_object.translation += offset;
        self
    }

    /// World velocity of the point of the body that is at `point_world`.
    pub(crate) fn velocity(&self, point_world: DVec3) -> DVec3 {
        self.linear_velocity + self.angular_velocity.cross(point_world - self.world_from_object.translation)
    }
}

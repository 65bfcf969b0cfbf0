//! Where a rigid body is and how it moves at one instant.

use glam::{DMat3, DVec3};
use scene::RigidTransform;

/// Pose and its exact first derivative.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// Object to world coordinates.
    pub world_from_object: RigidTransform,
    /// Velocity of the object's origin, world, units per second.
    pub linear_velocity: DVec3,
    /// Angular velocity, world, radians per second.
    pub angular_velocity: DVec3,
}

/// An angle and its rate, in radians and radians per second.
#[derive(Clone, Copy, Debug)]
pub struct Angle {
    /// Now.
    pub value: f64,
    /// Its derivative by time.
    pub rate: f64,
}

impl Angle {
    /// `mean + amplitude · sin(2π · time / period + phase)`.
    pub fn swinging(mean: f64, amplitude: f64, period_secs: f64, phase: f64, time_secs: f64) -> Self {
        let pulsation = std::f64::consts::TAU / period_secs;
        let argument = pulsation * time_secs + phase;
        Self { value: mean + amplitude * argument.sin(), rate: amplitude * pulsation * argument.cos() }
    }

    /// `rate · time`.
    pub fn turning(rate: f64, time_secs: f64) -> Self {
        Self { value: rate * time_secs, rate }
    }
}

impl Placement {
    /// Unturned at a fixed place.
    pub fn resting(position: DVec3) -> Self {
        Self::moving(position, DVec3::ZERO)
    }

    /// Unturned at a place that moves.
    pub fn moving(position: DVec3, velocity: DVec3) -> Self {
        let world_from_object = RigidTransform { rotation: DMat3::IDENTITY, translation: position };
        Self { world_from_object, linear_velocity: velocity, angular_velocity: DVec3::ZERO }
    }

    /// A body that hangs on this one at `offset` and turns about a unit `axis` (both in this body's coordinates).
    pub fn joint(&self, offset: DVec3, axis: DVec3, angle: Angle) -> Self {
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

    /// The same pose and motion, elsewhere.
    pub fn translated(mut self, offset: DVec3) -> Self {
        self.world_from_object.translation += offset;
        self
    }

    /// Velocity of the body's point that is at `point_world`.
    pub fn velocity(&self, point_world: DVec3) -> DVec3 {
        self.linear_velocity + self.angular_velocity.cross(point_world - self.world_from_object.translation)
    }
}

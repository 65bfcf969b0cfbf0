//! Gaussians in space and time that begin with a velocity.

use glam::{DQuat, DVec3};
use shaders::tape::{Real, Tensor};

use crate::model::ModelState;

/// The place in time and the motion of a Gaussian.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moving {
    /// Mean and standard deviation along time, in the method's unit.
    pub time: f64,
    pub deviation_time: f64,
    /// Scene units per unit of time.
    pub velocity: DVec3,
    /// Standard deviation along the velocity, scene units.
    pub deviation: f64,
    /// Rotation from the Gaussian's spatial axes to the world.
    pub rotation: DQuat,
}

impl Moving {
    /// The standard deviation along the fourth axis before rotation, and the left and right quaternions, such that the
    /// slice moves with the velocity and fades with `deviation_time`.
    ///
    /// The rotation by θ in the plane of time and the velocity turns variances b² (time) and a² (along the velocity) to
    /// Σ₁₄ = (b² − a²)·sin θ·cos θ and Σ₄₄ = b²·cos² θ + a²·sin² θ, so τ = tan θ solves v·a²·τ² − (b² − a²)·τ + v·b² = 0.
    /// It has a solution up to the speed (b² − a²) / 2ab; a higher speed is clamped to that, and to 0 if b ≤ a.
    fn tilted(&self) -> (f64, [DQuat; 2]) {
        let speed = self.velocity.length();
        let direction = if speed > 0.0 { self.velocity / speed } else { DVec3::X };
        let (a2, b) = (self.deviation.powi(2), self.deviation_time * (1.0 + speed * speed).sqrt());
        let (b2, difference) = (b * b, b * b - a2);
        let tangent = match difference * difference - 4.0 * speed * speed * a2 * b2 {
            root if root >= 0.0 && difference > 0.0 => 2.0 * speed * b2 / (difference + root.sqrt()),
            _ if difference > 0.0 => b / self.deviation,
            _ => 0.0,
        };
        let tilt = DQuat::from_axis_angle(direction, tangent.atan());
        (b, [tilt * self.rotation, tilt.conjugate() * self.rotation])
    }
}

/// Adds `times`, `log_scales_time`, `rotations_left` and `rotations_right` of a population.
pub(crate) fn insert_moving<T: Real>(state: &mut ModelState<T>, population: &str, gaussians: &[Moving]) {
    let tilted: Vec<(f64, [DQuat; 2])> = gaussians.iter().map(Moving::tilted).collect();
    let mut insert = |attribute: &str, columns: usize, values: Vec<f64>| {
        let values = values.into_iter().map(T::from_f64).collect();
        state.insert(format!("{population}.{attribute}"), Tensor::from_vec([gaussians.len(), columns], values));
    };
    insert("times", 1, gaussians.iter().map(|gaussian| gaussian.time).collect());
    insert("log_scales_time", 1, tilted.iter().map(|(deviation, _)| deviation.ln()).collect());
    for (side, name) in ["rotations_left", "rotations_right"].into_iter().enumerate() {
        let wxyz = |quaternion: DQuat| [quaternion.w, quaternion.x, quaternion.y, quaternion.z];
        insert(name, 4, tilted.iter().flat_map(|(_, sides)| wxyz(sides[side])).collect());
    }
}

#[cfg(test)]
mod tests {
    use shaders::tape::{Device, Tape};

    use super::*;
    use crate::bases::primitives4d::{parameters, slice};

    /// The velocity, and the share of the opacity one temporal deviation after the mean, as computed by the slicing.
    fn sliced(gaussian: Moving) -> (DVec3, f64) {
        let mut state = ModelState::<f64>::new();
        insert_moving(&mut state, "g", &[gaussian]);
        state.insert("g.opacity_logits", Tensor::full([1, 1], 0.0));
        let mut tape = Tape::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| false);
        let log_scales = tape.constant(Tensor::full([1, 3], gaussian.deviation.ln()));
        let sliced = slice(&mut tape, &parameters(&model, "g", log_scales), gaussian.time + gaussian.deviation_time);
        let logit = tape.value(sliced.opacity_logits).as_slice()[0];
        (DVec3::from_slice(tape.value(sliced.velocities).as_slice()), 2.0 / (1.0 + (-logit).exp()))
    }

    #[test]
    fn slices_move_with_the_velocity_and_fade_with_the_deviation() {
        let rotation = DQuat::from_rotation_arc(DVec3::Z, DVec3::new(0.6, 0.0, -0.8));
        for velocity in [DVec3::ZERO, DVec3::new(0.3, -0.2, 0.1), DVec3::new(0.0, 2.0, 0.0)] {
            let gaussian = Moving { time: 0.4, deviation_time: 0.1, velocity, deviation: 0.01, rotation };
            let (found, share) = sliced(gaussian);
            assert!((found - velocity).length() <= 1e-9, "{found} instead of {velocity}");
            assert!((share - (-0.5_f64).exp()).abs() <= 0.02, "{share}");
        }
    }

    #[test]
    fn a_gaussian_too_short_for_its_velocity_moves_as_fast_as_it_can() {
        let velocity = DVec3::new(3.0, 0.0, 0.0);
        let (found, _) =
            sliced(Moving { time: 0.4, deviation_time: 0.01, velocity, deviation: 0.03, rotation: DQuat::IDENTITY });
        assert!(found.x < 3.0 && found.x >= 0.0 && found.is_finite(), "{found}");
    }
}

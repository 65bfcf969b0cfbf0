//! Physical losses (equations 3 to 11), in units of frames and motion units.

use rand::RngExt as _;
use shaders::arrays::rows::weighted_mean_squared_difference;
use shaders::arrays::sample::{SampleSize, sample_rows};
use shaders::arrays::totals::total;
use shaders::geometry::camera::PinholeCamera;
use shaders::pointwise::{add, scale, sub};
use shaders::rasteriser::Rendered;
use shaders::tape::{Real, Tensor, Var};

use super::observation::{
    Observed, ProjectedPoints, displacement_map, flow_displacements, flow_map, surface_depth, true_displacements,
};
use super::trajectories::{STATIC_THRESHOLD, Trajectories, differences, foreground, frame_of, motion_unit};
use super::{PhysicalGaussians, VARIATION_HEAD, VELOCITY_HEAD};
use crate::data::TrainingView;
use crate::method::Step;

/// Components of a vector. The reduction averages over them, whereas the paper's squared norms sum over them.
const AXES: f64 = 3.0;

/// Predicted motion of M Gaussians per frame; tensors are [M, 3].
struct Kinematics {
    /// v^sf at t, t + δt, …: displacement from one evaluation of the field to the next.
    moved: Vec<Var>,
    /// v^attr at t, the predicted velocity.
    velocity: Option<Var>,
    /// δv^attr at t and t + δt, the predicted change of velocity.
    variations: Vec<Var>,
}

/// Factors that turn squared differences into losses.
struct Scales {
    /// [M] mask of compared Gaussians.
    weights: Var,
    /// The ramp, divided by the squared motion unit and the number of views.
    factor: f64,
}

impl PhysicalGaussians {
    /// Adds the physical losses of one view (eq 11), with their weights multiplied by `gain`.
    pub(super) fn physical_losses<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        view: &TrainingView<T>,
        rendered: &Rendered,
        gain: f64,
    ) -> anyhow::Result<()> {
        let candidates = foreground(step.tape, rendered, step.supplements.moving(view.index));
        let count = step.tape.constant(candidates.clone());
        let count = total(step.tape, count);
        step.count_skipped_deferred("physical losses of Gaussians in the background", count, candidates.len());
        let size = SampleSize { share: self.settings.sample_share, most: self.settings.sample_max };
        let sampled = sample_rows(step.tape.device(), &candidates, size, step.random.of("physical losses").random());
        let frames_ahead = self.parts.frames_ahead();
        let Some(followed) = Trajectories::follow(step, &self.base, &sampled, view.time, frames_ahead) else {
            return Ok(());
        };
        let kinematics = self.kinematics(step, &followed);
        let motion_unit = motion_unit(step.scene);
        let scales = Scales {
            weights: followed.weights,
            factor: gain * AXES / (motion_unit * motion_unit * step.views.len() as f64),
        };
        self.compare_velocities(step, &scales, &kinematics);
        self.compare_higher_orders(step, &scales, &kinematics);
        if self.observes(step, view) {
            step.clock.enter("loss flow");
            self.compare_observations(step, &scales, &kinematics, &followed, view, rendered)?;
        }
        Ok(())
    }

    /// Evaluates the heads that active losses need, at the instants that they need.
    fn kinematics<T: Real>(&self, step: &mut Step<'_, T>, followed: &Trajectories) -> Kinematics {
        let moved = followed.displacements(step.tape);
        // The heads output motion units, so that their values are of the order of 1.
        let unit = motion_unit(step.scene);
        let mut head = |name: &str, instant: usize| {
            let points = &followed.points[instant];
            let output = self.base.further_head(step.tape, step.model, step.scene, name, points);
            scale(step.tape, output, unit)
        };
        let velocity = self.parts.needs_velocity().then(|| head(VELOCITY_HEAD.0, 0));
        // δv at t is compared over two displacements; the jerk also compares δv at t + δt, over three.
        let variations = match self.parts.needs_variation() {
            true => usize::from(moved.len() >= 2) + usize::from(self.parts.higher_order && moved.len() >= 3),
            false => 0,
        };
        let variations = (0..variations).map(|instant| head(VARIATION_HEAD.0, instant)).collect();
        Kinematics { moved, velocity, variations }
    }

    /// Velocities (eq 3, at t and t + δt), displacements (eq 5, at t) and the change of velocity (eq 10).
    fn compare_velocities<T: Real>(&self, step: &mut Step<'_, T>, scales: &Scales, kinematics: &Kinematics) {
        let (weights, Kinematics { moved, velocity, variations }) = (&self.settings.weights, kinematics);
        let Some(velocity) = *velocity else { return };
        let here = scales.mean_square(step, velocity, moved[0]);
        if self.parts.displacement {
            scales.add(step, "displacement", weights.displacement, here);
        }
        if !self.parts.velocity {
            return;
        }
        let Some(&variation) = variations.first() else {
            return scales.add(step, "velocity", weights.velocity, here);
        };
        let next = add(step.tape, velocity, variation);
        let next = scales.mean_square(step, next, moved[1]);
        scales.add(step, "velocity", 0.5 * weights.velocity, here);
        scales.add(step, "velocity", 0.5 * weights.velocity, next);

        let none = step.tape.constant(Tensor::zeros(step.tape.value(variation).shape()));
        let from_heads = scales.mean_square(step, variation, none);
        let from_field = scales.mean_square(step, moved[1], moved[0]);
        scales.add(step, "temporal", weights.temporal, from_heads);
        scales.add(step, "temporal", weights.temporal, from_field);
    }

    /// Accelerations (eq 8) and jerks (eq 9).
    fn compare_higher_orders<T: Real>(&self, step: &mut Step<'_, T>, scales: &Scales, kinematics: &Kinematics) {
        if !self.parts.higher_order {
            return;
        }
        let (weights, Kinematics { moved, variations, .. }) = (&self.settings.weights, kinematics);
        let accelerations = differences(step.tape, moved);
        if let (Some(&from_heads), Some(&from_field)) = (variations.first(), accelerations.first()) {
            let value = scales.mean_square(step, from_heads, from_field);
            scales.add(step, "acceleration", weights.acceleration, value);
        }
        let (from_heads, from_field) = (differences(step.tape, variations), differences(step.tape, &accelerations));
        if let (Some(&from_heads), Some(&from_field)) = (from_heads.first(), from_field.first()) {
            let value = scales.mean_square(step, from_heads, from_field);
            scales.add(step, "jerk", weights.jerk, value);
        }
    }

    /// Observed motion: optical flow (β and γ of eqs 3 and 5) and exact displacements (eq 4).
    fn compare_observations<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        scales: &Scales,
        kinematics: &Kinematics,
        followed: &Trajectories,
        view: &TrainingView<T>,
        rendered: &Rendered,
    ) -> anyhow::Result<()> {
        let (weights, positions) = (&self.settings.weights, followed.points[0].positions);
        let surface = surface_depth(step.tape, rendered, self.settings.min_coverage);
        let points = [positions, followed.weights].map(|var| step.tape.value(var));
        let projected = ProjectedPoints::of(step.tape.device(), points, &view.camera, step.raster.near_view, surface);
        if let Some(velocity) = self.velocity_of(step, view) {
            let map = || displacement_map(velocity, step.scene.time_map.frame_secs);
            let map = step.constants.get(step.tape.device(), "displacement", view.index, map);
            let truth = true_displacements(&projected, &map);
            let (truth, valid) = truth.constants(step);
            let value = weighted_mean_squared_difference(step.tape, kinematics.moved[0], truth, valid);
            scales.add(step, "true_displacement", weights.true_displacement, value);
        }
        let Some(flow) = self.flow_of(step, view) else { return Ok(()) };
        let time_to = step.scene.time_map.normalized(flow.time_to_secs);
        let frames = (time_to - view.time) / frame_of(step.scene);
        let surface_to = self.surface_at(step, time_to, flow)?;
        let cameras = [&view.camera, &PinholeCamera::from(&flow.camera_to)];
        let map = step.constants.get(step.tape.device(), "flow", view.index, || flow_map(&flow.map));
        let observed = flow_displacements(&projected, cameras, [&map, &surface_to], frames);
        let arrived = followed.positions_at(step, &self.base, time_to);
        let moved = sub(step.tape, arrived, positions);
        let moved = scale(step.tape, moved, 1.0 / frames);
        let outlier = self.settings.flow_outlier;
        let (limit, least) = (observed.median_length(outlier), outlier * STATIC_THRESHOLD * step.scene.extent);
        for estimate in [kinematics.velocity, Some(moved)].into_iter().flatten() {
            let observed = observed.without_outliers(step.tape.value(estimate), &limit, least);
            let (target, weight) = observed.constants(step);
            let value = weighted_mean_squared_difference(step.tape, estimate, target, weight);
            scales.add(step, "flow", weights.flow * self.flow_weight(), value);
        }
        Ok(())
    }

    /// Weight of flow, which is part of eqs 3 and 5; in units of frames the two are one equation.
    fn flow_weight(&self) -> f64 {
        let weights = &self.settings.weights;
        let parts = [(self.parts.velocity, weights.velocity), (self.parts.displacement, weights.displacement)];
        parts.into_iter().filter(|(on, _)| *on).map(|(_, weight)| weight).sum()
    }
}

impl Scales {
    /// Mean of ‖a − b‖² over the compared Gaussians, divided by [`AXES`]; 0 if there are none.
    fn mean_square<T: Real>(&self, step: &mut Step<'_, T>, a: Var, b: Var) -> Var {
        weighted_mean_squared_difference(step.tape, a, b, self.weights)
    }

    fn add<T: Real>(&self, step: &mut Step<'_, T>, name: &'static str, weight: f64, value: Var) {
        step.add_loss(name, weight * self.factor, value);
    }
}

impl<T: Real> Observed<T> {
    /// Puts the displacements [M, 3] and the weights [M] on the tape as constants.
    fn constants(&self, step: &mut Step<'_, T>) -> (Var, Var) {
        (step.tape.detach_value(self.displacements.clone()), step.tape.detach_value(self.weights.clone()))
    }
}

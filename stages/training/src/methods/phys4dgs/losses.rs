//! Physical losses (equations 3 to 11), in units of frames and motion units.

use rand::RngExt as _;
use shaders::arrays::rows::weighted_mean_squared_difference;
use shaders::arrays::sample::{SampleSize, sample_rows};
use shaders::arrays::totals::total;
use shaders::pointwise::{add, scale};
use shaders::rasteriser::Rendered;
use shaders::tape::{Real, Tensor, Var};

use super::flow::Surfaces;
use super::observation::{Observed, ProjectedPoints, displacement_map, surface_depth, true_displacements};
use super::trajectories::{STATIC_THRESHOLD, Trajectories, differences, foreground, motion_unit};
use super::{PhysicalGaussians, VARIATION_HEAD, VELOCITY_HEAD};
use crate::bases::static_mask::MAY_MOVE;
use crate::clock::LOSSES;
use crate::data::TrainingView;
use crate::method::Step;

/// Components of a vector. The reduction averages over them, whereas the paper's squared norms sum over them.
const AXES: f64 = 3.0;

/// Predicted motion of M Gaussians per frame; tensors are [M, 3].
pub(super) struct Kinematics {
    /// v^sf at t, t + δt, …: displacement from one evaluation of the field to the next.
    moved: Vec<Var>,
    /// v^attr at t, the predicted velocity.
    pub velocity: Option<Var>,
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
    /// Adds the physical losses of one view (eq 11), with their weights multiplied by `gain`. The time spent on the
    /// trajectories, which all of these losses share, is charged to none of them.
    pub(super) fn physical_losses<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        view: &TrainingView<T>,
        rendered: &Rendered,
        gain: f64,
    ) -> anyhow::Result<()> {
        step.clock.enter("trajectories");
        let moving = step.supplements.moving(view.index).filter(|_| self.parts.foreground);
        let candidates = foreground(step.tape, rendered, moving, step.model.find(MAY_MOVE));
        let count = step.tape.constant(candidates.clone());
        let count = total(step.tape, count);
        step.count_skipped_deferred("physical losses of Gaussians in the background", count, candidates.len());
        let size = SampleSize { share: self.settings.sample_share, most: self.settings.sample_max };
        let sampled = sample_rows(step.tape.device(), &candidates, size, step.random.of("physical losses").random());
        let (parts, observes) = (self.due(step.iteration), self.observes(step, view));
        let followed = Trajectories::follow(step, &self.base, &sampled, view.time, parts.frames_ahead(), observes);
        let Some(followed) = followed else { return Ok(()) };
        let kinematics = self.kinematics(step, &followed);
        let motion_unit = motion_unit(step.scene);
        let scales = Scales {
            weights: followed.weights,
            factor: gain * AXES / (motion_unit * motion_unit * step.views.len() as f64),
        };
        step.clock.enter(LOSSES);
        self.compare_velocities(step, &scales, &kinematics);
        if parts.higher_order {
            self.compare_higher_orders(step, &scales.of_every(self.settings.higher_order_interval), &kinematics);
        }
        if observes {
            self.compare_observations(step, &scales, &kinematics, &followed, view, rendered)?;
        }
        Ok(())
    }

    /// Evaluates the heads that active losses need, at the instants that they need.
    pub(super) fn kinematics<T: Real>(&self, step: &mut Step<'_, T>, followed: &Trajectories) -> Kinematics {
        let moved = followed.displacements(step.tape);
        // The heads output motion units, so that their values are of the order of 1.
        let unit = motion_unit(step.scene);
        let mut head = |name: &str, instant: usize| {
            // The heads follow the motion: a head with gradients into the field would pull it towards the head's
            // initial value, no motion.
            let hidden = step.tape.detach(followed.points[instant].hidden);
            let output = self.base.further_head(step.tape, step.model, step.scene, name, hidden);
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
        let here = scales.followed(step, velocity, moved[0]);
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
        let next = scales.followed(step, next, moved[1]);
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
        let (weights, Kinematics { moved, variations, .. }) = (&self.settings.weights, kinematics);
        let accelerations = differences(step.tape, moved);
        if let (Some(&from_heads), Some(&from_field)) = (variations.first(), accelerations.first()) {
            let value = scales.followed(step, from_heads, from_field);
            scales.add(step, "acceleration", weights.acceleration, value);
        }
        let (from_heads, from_field) = (differences(step.tape, variations), differences(step.tape, &accelerations));
        if let (Some(&from_heads), Some(&from_field)) = (from_heads.first(), from_field.first()) {
            let value = scales.followed(step, from_heads, from_field);
            scales.add(step, "jerk", weights.jerk, value);
        }
    }

    /// Observed motion: exact displacements (eq 4) and optical flow (β and γ of eqs 3, 5, 8 and 9).
    fn compare_observations<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        scales: &Scales,
        kinematics: &Kinematics,
        followed: &Trajectories,
        view: &TrainingView<T>,
        rendered: &Rendered,
    ) -> anyhow::Result<()> {
        let surface = surface_depth(step.tape, rendered, self.settings.min_coverage);
        if let Some(velocity) = self.velocity_of(step, view) {
            let points = [followed.points[0].positions, followed.weights].map(|var| step.tape.value(var));
            let (device, near_view) = (step.tape.device(), step.raster.near_view);
            let projected = ProjectedPoints::of(device, points, &view.camera, near_view, surface.clone());
            let map = || displacement_map(velocity, step.scene.time_map.frame_secs);
            let map = step.constants.get(step.tape.device(), "displacement", view.index, map);
            let (truth, valid) = true_displacements(&projected, &map).constants(step);
            let value = weighted_mean_squared_difference(step.tape, kinematics.moved[0], truth, valid);
            scales.add(step, "true_displacement", self.settings.weights.true_displacement, value);
        }
        let sightings = self.sightings(step, followed, view, Surfaces::of(view, surface))?;
        let weights = &self.settings.weights;
        if let Some(first) = sightings.first() {
            let estimates = [kinematics.velocity, Some(first.moved)];
            let scales = scales.of_every(self.settings.flow_interval);
            self.compare_with_flow(step, &scales, ("flow", self.flow_weight()), &first.observed, estimates);
        }
        if !self.due(step.iteration).higher_order {
            return Ok(());
        }
        let scales = &scales.of_every(self.settings.higher_order_interval);
        let changes: Vec<_> =
            sightings.windows(2).map(|pair| Observed::change([&pair[0].observed, &pair[1].observed])).collect();
        let accelerations = differences(step.tape, &kinematics.moved);
        if let Some(seen) = changes.first() {
            let estimates = [kinematics.variations.first().copied(), accelerations.first().copied()];
            self.compare_with_flow(step, scales, ("flow_acceleration", weights.acceleration), seen, estimates);
        }
        if let [first, second] = &changes[..] {
            let [heads, field] = [&kinematics.variations, &accelerations].map(|of| differences(step.tape, of));
            let estimates = [heads.first().copied(), field.first().copied()];
            self.compare_with_flow(
                step,
                scales,
                ("flow_jerk", weights.jerk),
                &Observed::change([first, second]),
                estimates,
            );
        }
        Ok(())
    }

    /// Adds the loss of estimates [M, 3] against the observed flow, without outliers; the weight is relative to β = γ.
    fn compare_with_flow<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        scales: &Scales,
        (name, weight): (&'static str, f64),
        observed: &Observed<T>,
        estimates: [Option<Var>; 2],
    ) {
        let (outlier, still) = (self.settings.flow_outlier, STATIC_THRESHOLD * step.scene.extent);
        let (limit, least) = (observed.median_length(still, outlier), outlier * still);
        for estimate in estimates.into_iter().flatten().filter(|_| weight > 0.0) {
            let value = step.tape.value(estimate);
            let observed = observed.trusting_depth(value, self.settings.depth_trust);
            let observed = observed.without_outliers(value, &limit, least);
            let (target, counts) = observed.constants(step);
            let value = weighted_mean_squared_difference(step.tape, estimate, target, counts);
            scales.add(step, name, weight * self.settings.weights.flow, value);
        }
    }

    /// Weight of flow, which is part of eqs 3 and 5; in units of frames the two are one equation.
    fn flow_weight(&self) -> f64 {
        let weights = &self.settings.weights;
        let parts = [(self.parts.velocity, weights.velocity), (self.parts.displacement, weights.displacement)];
        parts.into_iter().filter(|(on, _)| *on).map(|(_, weight)| weight).sum()
    }
}

impl Scales {
    /// The scales of losses that only every `interval`-th step evaluates.
    fn of_every(&self, interval: u64) -> Self {
        Self { weights: self.weights, factor: self.factor * interval as f64 }
    }

    /// Mean of ‖a − b‖² over the compared Gaussians, divided by [`AXES`]; 0 if there are none.
    fn mean_square<T: Real>(&self, step: &mut Step<'_, T>, a: Var, b: Var) -> Var {
        weighted_mean_squared_difference(step.tape, a, b, self.weights)
    }

    /// [`Scales::mean_square`] of a head's output and the field's motion, without a gradient into the field: heads
    /// start at zero, and their gradients would slow the motion down.
    fn followed<T: Real>(&self, step: &mut Step<'_, T>, from_heads: Var, from_field: Var) -> Var {
        let from_field = step.tape.detach(from_field);
        self.mean_square(step, from_heads, from_field)
    }

    fn add<T: Real>(&self, step: &mut Step<'_, T>, name: &'static str, weight: f64, value: Var) {
        step.add_loss(name, weight * self.factor, value);
    }
}

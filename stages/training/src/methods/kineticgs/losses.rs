//! Losses of both phases (KineticGS equation 13).

use shaders::arrays::totals::total;
use shaders::pointwise::{scale, sub};
use shaders::tape::{Real, Var};

use super::coherence::{displacement_incoherence, window_incoherence};
use super::energy_flow::{FlowView, energy_flow};
use super::neighbors::Pairs;
use super::particles::{Moved, Particles};
use super::weights::Weights;
use super::{COHERENCE, ENERGY_FLOW, KineticGaussians, MOMENTUM_INIT};
use crate::bases::anchors;
use crate::data::TrainingView;
use crate::method::Step;

impl<T: Real> KineticGaussians<T> {
    /// The losses of `coarse`: static anchors, on static pixels.
    pub(super) fn coarse_losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        for view in step.views {
            step.clock.enter("motion");
            let spawned = self.static_gaussians(step.tape, step.model, &view.camera);
            let mask = self.static_pixels(step, view);
            anchors::compare(step, &spawned, view, mask)?;
        }
        Ok(())
    }

    /// Mask of the static pixels in a view; `None` if `coarse_all` is on, energy flow is off or the view has no priors, or if
    /// a mask of the effect `seed-from-masks` hides its moving pixels.
    fn static_pixels(&self, step: &mut Step<'_, T>, view: &TrainingView<T>) -> Option<Var> {
        let is_hidden = self.shared.has_seeds() && step.supplements.moving(view.index).is_some();
        if self.settings.coarse_all || !self.has(ENERGY_FLOW) || is_hidden {
            return None;
        }
        let flow_view = FlowView::of(step.dataset, step.supplements, view.index)?;
        let device = step.tape.device();
        let mask = step.constants.get(device, "static pixels", view.index, || flow_view.static_pixels());
        let pixels = view.camera.height * view.camera.width;
        let mask = step.tape.constant(mask);
        let kept = total(step.tape, mask);
        let kept = scale(step.tape, kept, 1.0 / 3.0);
        step.count_skipped_deferred("moving pixels in coarse", kept, pixels);
        Some(mask)
    }

    /// The losses of `fine` with motion.
    pub(super) fn fine_losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        let weights = self.settings.losses.at(step.iteration, self.shared.schedule_scale);
        step.clock.enter("motion");
        let particles = self.particles(step.tape, step.model, step.scene);
        let pairs = self.neighbor_pairs(step, &particles, &weights);
        if self.has(MOMENTUM_INIT) {
            let (anchors, of_them) = (particles.population.rows.rows(), particles.population.rows.len());
            step.count_skipped("motion of static anchors", anchors - of_them, anchors);
        }
        let mut displacements = Vec::new();
        for view in step.views {
            step.clock.enter("motion");
            let moment = step.moment(view);
            let moved = self.motion.at(step.tape, step.model, &particles, view.time);
            let spawned = self.gaussians(step.tape, step.model, &moved, &moment);
            anchors::compare(step, &spawned, view, None)?;
            self.flow_loss(step, &particles, &moved, view, &weights);
            displacements.extend(moved.displacements);
        }
        self.displacement_loss(step, &displacements, pairs, &weights);
        self.window_losses(step, &particles, pairs, &weights);
        self.motion.deformation.regularize(step);
        self.local.regularize(step);
        Ok(())
    }

    /// Pairs of neighbours among the particles; `None` if coherence is off.
    fn neighbor_pairs<'p>(
        &self,
        step: &mut Step<'_, T>,
        particles: &'p Particles<'_, T>,
        weights: &Weights,
    ) -> Option<&'p Pairs> {
        if !self.has(COHERENCE) || weights.coherence == 0.0 {
            return None;
        }
        let search = self.settings.neighbors.draw(step.random.of("neighbors"));
        particles.population.pairs(search, self.settings.anchors.voxel_size * particles.scene.unit_world)
    }

    fn flow_loss(
        &self,
        step: &mut Step<'_, T>,
        particles: &Particles<'_, T>,
        moved: &Moved,
        view: &TrainingView<T>,
        weights: &Weights,
    ) {
        if !self.has(ENERGY_FLOW) || weights.flow == 0.0 {
            return;
        }
        let flow_view = FlowView::of(step.dataset, step.supplements, view.index);
        step.count_skipped("energy-flow loss of views without priors", usize::from(flow_view.is_none()), 1);
        let Some(flow_view) = flow_view else { return };
        let time_to = step.scene.time_map.normalized(flow_view.time_to_secs());
        let maps = flow_view.maps(step.tape.device(), step.constants);
        let found = energy_flow(step.tape, step.model, &self.motion, particles, moved, &maps, time_to);
        let (what, count) = ("energy-flow loss of particles not seen", particles.population.rows.len());
        let Some(followed) = found else { return step.count_skipped(what, count, count) };
        step.count_skipped_deferred(what, followed.count, count);
        let weight = weights.flow / (step.scene.extent * step.views.len() as f64);
        step.add_loss("energy_flow", weight, followed.distance);
    }

    /// Compares the motion of neighbours between the views of the step, [P, 3] each; with a single view, their
    /// displacements from their canonical positions. Motion between two times, unlike a displacement, does not depend on
    /// the instant at which a particle was sampled.
    fn displacement_loss(
        &self,
        step: &mut Step<'_, T>,
        displacements: &[Var],
        pairs: Option<&Pairs>,
        weights: &Weights,
    ) {
        let Some(pairs) = pairs else { return };
        let motions: Vec<Var> = match displacements {
            [single] => vec![*single],
            several => several.windows(2).map(|pair| sub(step.tape, pair[1], pair[0])).collect(),
        };
        let share = weights.coherence / motions.len().max(1) as f64;
        for motion in motions {
            let value = displacement_incoherence(step.tape, motion, pairs, step.scene.extent);
            step.add_loss("coherence", share, value);
        }
    }

    /// Window losses: even spread over the clip, and coherence among neighbours.
    fn window_losses(
        &self,
        step: &mut Step<'_, T>,
        particles: &Particles<'_, T>,
        pairs: Option<&Pairs>,
        weights: &Weights,
    ) {
        let Some(windows) = particles.windows else { return };
        if weights.activation > 0.0 {
            let value = windows.unevenness(step.tape);
            step.add_loss("activation", weights.activation, value);
        }
        if let Some(value) = pairs.and_then(|pairs| window_incoherence(step.tape, particles, pairs)) {
            step.add_loss("coherence", weights.coherence, value);
        }
    }
}

//! What a step of either phase minimises (KineticGS equation 13).

use shaders::tape::{Real, Var};

use super::coherence::{displacement_incoherence, window_incoherence};
use super::energy_flow::{FlowView, energy_flow, static_mask};
use super::particles::{Moved, Particles};
use super::weights::Weights;
use super::{ACTIVATION, COHERENCE, ENERGY_FLOW, KineticGaussians, MOMENTUM_INIT};
use crate::bases::anchors;
use crate::method::{Step, TrainingView};

impl KineticGaussians {
    /// The losses of `coarse`: anchors as if nothing moved, on the pixels that do not.
    pub(super) fn coarse_losses<T: Real>(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        for view in step.views {
            step.clock.enter("motion");
            let canonical = anchors::Anchors::stored(step.model);
            let spawned = anchors::spawn(step.tape, step.model, &canonical, &view.camera);
            let rendered = step.render_rows(&spawned.splats, view, spawned.rows())?;
            let mask = self.static_pixels(step, view);
            anchors::photometric(step, rendered.color, view, mask);
        }
        Ok(())
    }

    /// A mask of what does not move in a view, where that is asked for and known.
    fn static_pixels<T: Real>(&self, step: &mut Step<'_, T>, view: &TrainingView<T>) -> Option<Var> {
        if self.settings.coarse_all || !self.has(ENERGY_FLOW) {
            return None;
        }
        let moving = FlowView::of(step.dataset, step.supplements, view.index)?.moving_pixels();
        step.count_skipped("moving pixels in coarse", moving.iter().filter(|moves| **moves).count(), moving.len());
        Some(step.tape.constant(static_mask(&moving, view.camera.height, view.camera.width)))
    }

    /// The losses of `fine` with motion.
    pub(super) fn fine_losses<T: Real>(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        let weights = self.settings.losses.at(step.iteration, self.shared.schedule_scale);
        step.clock.enter("motion");
        let particles = self.particles(step.tape, step.model);
        let pairs = self.neighbor_pairs(step, &particles, &weights);
        for view in step.views {
            step.clock.enter("motion");
            let moment = step.moment(view);
            let moved = self.motion.at(step.tape, step.model, &particles, view.time);
            self.count_skipped(step, &particles, &moved);
            let spawned = self.gaussians(step.tape, step.model, &moved, &moment);
            let rendered = step.render_rows(&spawned.splats, view, spawned.rows())?;
            anchors::photometric(step, rendered.color, view, None);
            self.flow_loss(step, &particles, &moved, view, &weights);
            self.displacement_loss(step, &particles, &moved, &pairs, &weights);
        }
        self.window_losses(step, &particles, &pairs, &weights);
        self.motion.deformation.regularize(step);
        self.local.regularize(step);
        Ok(())
    }

    fn count_skipped<T: Real>(&self, step: &mut Step<'_, T>, particles: &Particles, moved: &Moved) {
        let (anchors, of_them) = (particles.rows.rows(), particles.rows.len());
        if self.has(MOMENTUM_INIT) {
            step.count_skipped("motion of static anchors", anchors - of_them, anchors);
        }
        if self.has(ACTIVATION) {
            step.count_skipped("motion outside activation windows", of_them - moved.active.len(), of_them);
        }
    }

    /// Pairs of neighbours among the particles; none where coherence is off.
    fn neighbor_pairs<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        particles: &Particles,
        weights: &Weights,
    ) -> Vec<[u32; 2]> {
        if !self.has(COHERENCE) || weights.coherence == 0.0 {
            return Vec::new();
        }
        let positions = particles.canonical(step.tape);
        self.settings.neighbors.pairs(&positions, self.settings.anchors.voxel_size, step.random)
    }

    fn flow_loss<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        particles: &Particles,
        moved: &Moved,
        view: &TrainingView<T>,
        weights: &Weights,
    ) {
        if !self.has(ENERGY_FLOW) || weights.flow == 0.0 {
            return;
        }
        let flow_view = FlowView::of(step.dataset, step.supplements, view.index);
        step.count_skipped("energy flow of views without priors", usize::from(flow_view.is_none()), 1);
        let Some(flow_view) = flow_view else { return };
        let time_to = step.scene.time_map.normalized(flow_view.time_to_secs());
        let found = energy_flow(step.tape, step.model, &self.motion, particles, moved, &flow_view, time_to);
        let followed = found.map_or(0, |(_, count)| count);
        step.count_skipped("energy flow of particles not seen", particles.rows.len() - followed, particles.rows.len());
        if let Some((distance, _)) = found {
            let weight = weights.flow / (step.scene.extent * step.views.len() as f64);
            step.add_loss("energy_flow", weight, distance);
        }
    }

    fn displacement_loss<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        particles: &Particles,
        moved: &Moved,
        pairs: &[[u32; 2]],
        weights: &Weights,
    ) {
        let share = weights.coherence / step.views.len() as f64;
        let extent = step.scene.extent;
        if let Some(value) = displacement_incoherence(step.tape, moved, particles.rows.len(), pairs, extent) {
            step.add_loss("coherence", share, value);
        }
    }

    /// The losses of the windows: spread over all time, alike among neighbours.
    fn window_losses<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        particles: &Particles,
        pairs: &[[u32; 2]],
        weights: &Weights,
    ) {
        let Some(windows) = particles.windows else { return };
        if weights.activation > 0.0 {
            let value = windows.unevenness(step.tape);
            step.add_loss("activation", weights.activation, value);
        }
        if let Some(value) = window_incoherence(step.tape, particles, pairs) {
            step.add_loss("coherence", weights.coherence, value);
        }
    }
}

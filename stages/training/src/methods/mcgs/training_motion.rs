//! Node motion at training times, with the losses over the neighbouring frames.

use rand::RngExt as _;
use shaders::arrays::rows::{RowIndex, gather};
use shaders::geometry::camera::PinholeCamera;
use shaders::pointwise::add;
use shaders::tape::Real;

use super::node_motion::{NodeMotion, Predictions};
use super::{MarkovGaussians, noise, physics, prediction};
use crate::bases::control_nodes::{Rigidity, rigidity_left};
use crate::clock::LOSSES;
use crate::method::Step;

impl MarkovGaussians {
    /// Node motion at the time of a training view; adds the losses over the neighbouring frames.
    ///
    /// A random share of the views renders the direct branch alone. The mixture continues that branch's previous state,
    /// so with mixtures alone, an error in the branch that alternates in sign from frame to frame would never appear in
    /// an image.
    pub(super) fn training_motion<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        time: f64,
        camera: &PinholeCamera,
    ) -> NodeMotion {
        if step.random.of("direct views").random::<f64>() < self.settings.mixing.direct_views {
            step.count_skipped("Markov chain in views that train the direct branch alone", 1, 1);
            return self.nodes.direct(step.tape, step.model, &[time]);
        }
        step.count_skipped("Markov chain in views that train the direct branch alone", 0, 1);
        let frame = step.scene.training_interval();
        let has_neighbors = time - frame >= 0.0 && time + frame <= 1.0;
        let initial = if self.is_rigid { self.settings.rigidity } else { 0.0 };
        let weight = initial * rigidity_left(&self.shared, step.iteration);
        if !has_neighbors || !(self.has_physics || weight > 0.0) {
            let predictions = self.predictions(step, &[time]);
            return self.noisy(step, &predictions, camera);
        }
        let times = [time - frame, time, time + frame];
        let predictions = self.predictions(step, &times);
        let motions = self.nodes.mix(step.tape, step.model, &predictions);
        let frames = self.nodes.split(step.tape, &motions, times.len());
        step.clock.enter(LOSSES);
        if self.has_physics {
            physics::add_losses(step, &self.settings.physics, &frames);
        }
        if weight > 0.0 {
            self.add_rigidity(step, weight, &frames);
        }
        step.clock.enter("motion");
        if !self.has_noise {
            return frames[1];
        }
        let nodes = step.tape.value(frames[1].translations).rows();
        let middle = RowIndex::new((nodes..2 * nodes).map(|row| row as u32).collect(), times.len() * nodes);
        let of_middle = predictions.map(|var| gather(step.tape, var, &middle));
        self.noisy(step, &of_middle, camera)
    }

    /// Both branches at times that follow each other by one frame interval; adds the loss of the predictions if it has a weight.
    fn predictions<T: Real>(&self, step: &mut Step<'_, T>, times: &[f64]) -> Predictions {
        let predictions = self.nodes.predict(step.tape, step.model, times, step.scene);
        if self.settings.prediction > 0.0 {
            step.clock.enter(LOSSES);
            let loss = prediction::loss(step.tape, &predictions, step.scene);
            step.add_loss("prediction", self.settings.prediction / step.views.len() as f64, loss);
            step.clock.enter("motion");
        }
        predictions
    }

    /// The mixture of direct and predicted motion, with noise on the prediction if the effect is on.
    fn noisy<T: Real>(&self, step: &mut Step<'_, T>, predictions: &Predictions, camera: &PinholeCamera) -> NodeMotion {
        let predictions = match self.has_noise {
            true => noise::disturb(step, predictions, &self.settings.noise, camera),
            false => *predictions,
        };
        self.nodes.mix(step.tape, step.model, &predictions)
    }

    /// Rigidity of the nodes from one frame to the next, among neighbours at that frame. Neighbours of the canonical
    /// nodes may belong to different objects, because the static warm-up leaves nodes along the trails of moving
    /// objects.
    fn add_rigidity<T: Real>(&self, step: &mut Step<'_, T>, weight: f64, frames: &[NodeMotion]) {
        let nodes = step.model.get("nodes.positions");
        let [before, after] = [1, 2].map(|frame| add(step.tape, nodes, frames[frame].translations));
        let neighbors = self.settings.nodes.rigid_neighbors;
        let unit = step.scene.unit_world;
        let Some(rigidity) = Rigidity::new(step.tape.value(before), neighbors, unit) else { return };
        let energy = rigidity.energy(step.tape, before, after);
        step.add_loss("rigidity", weight / (unit * unit * step.views.len() as f64), energy);
    }
}

//! Optical flow seen at the followed instants: the third source of motion (eqs 2, 6 and 7).

use scene::VelocityMap;
use shaders::geometry::camera::PinholeCamera;
use shaders::pointwise::{scale, sub};
use shaders::rasteriser;
use shaders::tape::{Real, Tensor, Var};

use super::PhysicalGaussians;
use super::observation::{Arrival, Observed, ProjectedPoints, flow_displacements, flow_map, surface_depth};
use super::trajectories::{SAME_INSTANT, Trajectories, frame_of};
use crate::data::{FlowPrior, TrainingView};
use crate::method::{Base, Moment, Step, too_large};
use crate::model::Variables;

/// A view with flow that points forward in time.
struct FlowView<'a> {
    index: usize,
    camera: PinholeCamera,
    flow: &'a FlowPrior,
}

/// Flow seen at one instant.
pub(super) struct Sighting<T: Real> {
    /// v^flow, scene units per frame.
    pub observed: Observed<T>,
    /// [M, 3]: v^sf over the same time, scene units per frame.
    pub moved: Var,
    /// Whether the flow spans exactly one frame.
    is_of_one_frame: bool,
}

/// Surface depths [H, W] that a step has rendered, by camera and time.
pub(super) struct Surfaces<T: Real> {
    known: Vec<(PinholeCamera, f64, Tensor<T>)>,
}

impl<T: Real> Surfaces<T> {
    /// The surface of the step's own render.
    pub(super) fn of(view: &TrainingView<T>, surface: Tensor<T>) -> Self {
        Self { known: vec![(view.camera, view.time, surface)] }
    }
}

impl PhysicalGaussians {
    /// Whether a step on this view uses any observation; depth is rendered only then.
    pub(super) fn observes<T: Real>(&self, step: &Step<'_, T>, view: &TrainingView<T>) -> bool {
        self.velocity_of(step, view).is_some() || self.flow_of(step, view.index, view.time).is_some()
    }

    /// The exact velocities of a view, if known and needed.
    pub(super) fn velocity_of<'a, T: Real>(
        &self,
        step: &Step<'a, T>,
        view: &TrainingView<T>,
    ) -> Option<&'a VelocityMap> {
        let wanted = self.parts.true_displacement && view.time < 1.0;
        step.supplements.view(view.index).filter(|_| wanted)?.velocity.as_ref()
    }

    /// Flow seen in the step's view and, for eqs 8 and 9, at up to two following instants. Those must have a view with
    /// flow, and all flow must then span exactly one frame.
    pub(super) fn sightings<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        followed: &Trajectories,
        view: &TrainingView<T>,
        mut surfaces: Surfaces<T>,
    ) -> anyhow::Result<Vec<Sighting<T>>> {
        let mut found = Vec::new();
        let instants = if self.due(step.iteration).higher_order { 3 } else { 1 };
        for (at, &time) in followed.times.iter().enumerate().take(instants) {
            let flow_view = match at {
                0 => self.flow_of(step, view.index, view.time).map(|flow| (view.index, view.camera, flow)),
                _ => self.flow_at(step, time, &view.camera),
            };
            let Some((index, camera, flow)) = flow_view else { break };
            let sighting = self.sighting(step, followed, at, &FlowView { index, camera, flow }, &mut surfaces)?;
            // Frame-to-frame differences (eqs 8 and 9) need flow over exactly one frame.
            if at > 0 && !sighting.is_of_one_frame
                || found.first().is_some_and(|first: &Sighting<T>| !first.is_of_one_frame)
            {
                break;
            }
            found.push(sighting);
        }
        Ok(found)
    }

    /// Flow at an instant of the followed Gaussians, and their motion in the model over the same time.
    fn sighting<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        followed: &Trajectories,
        at: usize,
        from: &FlowView<'_>,
        surfaces: &mut Surfaces<T>,
    ) -> anyhow::Result<Sighting<T>> {
        let (time, positions) = (followed.times[at], followed.points[at].positions);
        let time_to = step.scene.time_map.normalized(from.flow.time_to_secs);
        let frames = (time_to - time) / frame_of(step.scene);
        let camera_to = PinholeCamera::from(&from.flow.camera_to);
        let surface = self.surface(step, surfaces, &from.camera, time)?;
        let surface_to = self.surface(step, surfaces, &camera_to, time_to)?;
        let points = [positions, followed.weights].map(|var| step.tape.value(var));
        let projected = ProjectedPoints::of(step.tape.device(), points, &from.camera, step.raster.near_view, surface);
        let arrived = followed.positions_at(step, &self.base, time_to);
        let moved = step.tape.value(arrived);
        let to = Arrival { camera: &camera_to, surface_depth: &surface_to, moved, frames };
        let map = step.constants.get(step.tape.device(), "flow", from.index, || flow_map(&from.flow.map));
        let observed = flow_displacements(&projected, &from.camera, &map, &to);
        let moved = sub(step.tape, arrived, positions);
        let moved = scale(step.tape, moved, 1.0 / frames);
        Ok(Sighting { observed, moved, is_of_one_frame: (frames - 1.0).abs() <= SAME_INSTANT })
    }

    /// The optical flow of a view, if given and needed, if it points forward in time and if the view shows motion.
    fn flow_of<'a, T: Real>(&self, step: &Step<'a, T>, index: usize, time: f64) -> Option<&'a FlowPrior> {
        let flow = step.supplements.view(index).filter(|_| self.due(step.iteration).flow)?.flow.as_ref()?;
        let points_forward = step.scene.time_map.normalized(flow.time_to_secs) > time;
        (points_forward && !is_static(step, index)).then_some(flow)
    }

    /// A training view with flow at a time, if there is one; preferably of the same camera pose.
    fn flow_at<'a, T: Real>(
        &self,
        step: &Step<'a, T>,
        time: f64,
        camera: &PinholeCamera,
    ) -> Option<(usize, PinholeCamera, &'a FlowPrior)> {
        let same = SAME_INSTANT * frame_of(step.scene);
        let then = step.dataset.train.iter().filter(|view| (view.time - time).abs() <= same);
        let with_flow = then.filter_map(|view| Some((view.index, view.camera, self.flow_of(step, view.index, time)?)));
        with_flow.min_by_key(|(_, other, _)| other != camera)
    }

    /// Surface depths [H, W] at a time, rendered without gradients.
    fn surface<T: Real>(
        &self,
        step: &mut Step<'_, T>,
        surfaces: &mut Surfaces<T>,
        camera: &PinholeCamera,
        time: f64,
    ) -> anyhow::Result<Tensor<T>> {
        let same = SAME_INSTANT * frame_of(step.scene);
        let is_same = |(known, at, _): &&(PinholeCamera, f64, Tensor<T>)| known == camera && (at - time).abs() <= same;
        if let Some((.., surface)) = surfaces.known.iter().find(is_same) {
            return Ok(surface.clone());
        }
        let mut child = step.tape.child();
        let constant = |(name, var): (&str, _)| (name.to_string(), child.constant(step.tape.value(var).clone()));
        let model = Variables::new(step.model.iter().map(constant).collect());
        let moment =
            Moment { scene: step.scene, phase: step.phase, time, camera, sh_degree: step.sh_degree, left_out: None };
        let splats = self.base.splats(&mut child, &model, &moment)?;
        let rendered = rasteriser::render(&mut child, &splats, None, camera, &step.raster).map_err(too_large)?;
        let surface = surface_depth(&child, &rendered, self.settings.min_coverage);
        step.tape.absorb(child);
        surfaces.known.push((*camera, time, surface.clone()));
        Ok(surface)
    }
}

/// Whether a view is known to show no motion.
fn is_static<T: Real>(step: &Step<'_, T>, index: usize) -> bool {
    step.supplements.moving(index).is_some_and(|moving| moving.labels.iter().all(|&label| label == 0))
}

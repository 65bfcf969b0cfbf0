//! A trained model in use: Gaussians and images at any time, from any camera.

mod edit;
mod frame;
mod language;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::Context as _;
use engine::{Failure, FailureKind};
use scene::Gaussians;
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::{self, RasterSettings, Rendered, SplatVars};
use shaders::tape::{Device, Readback, Tape, Tensor, Var};

use crate::artifact::Model;
use crate::bases::gaussians::{baked, present};
use crate::data::SceneFacts;
use crate::method::{Method, Moment, raster_settings, too_large};

use crate::model::ModelState;
use crate::params::TrainingParams;

use edit::ActiveEdit;
pub use edit::Edit;
pub use frame::StartedFrame;
pub use language::SemanticImage;

/// A model with its method, ready to render.
pub struct Player {
    method: Box<dyn Method<f32>>,
    state: ModelState<f32>,
    prompt_names: Vec<String>,
    scene: SceneFacts,
    device: Device,
    phase: String,
    sh_degree: usize,
    /// The largest number of intersections of a render so far, the capacity of later renders; a render that overflows
    /// it is repeated.
    capacity: AtomicUsize,
    /// The edit that all images show.
    edit: Option<ActiveEdit>,
}

/// Positions of the Gaussians at one time, indexed so that the same Gaussian can be found at another time.
#[derive(Clone, Debug)]
pub struct Positions {
    /// [N, 3] world positions of all splats, including hidden ones.
    pub world: Vec<[f32; 3]>,
    /// The model's row of each splat; `None`: all rows in order.
    rows: Option<Vec<u32>>,
    /// The visible splats by row; `None`: all splats are visible.
    by_row: Option<BTreeMap<u32, usize>>,
}

impl Positions {
    /// Positions of splats; those with an index in `visible` are not hidden.
    fn new(world: Vec<[f32; 3]>, rows: Option<Vec<u32>>, visible: &[u32]) -> Self {
        let row = |splat: u32| rows.as_ref().map_or(splat, |rows| rows[splat as usize]);
        let is_simple = rows.is_none() && visible.len() == world.len();
        let by_row = (!is_simple).then(|| visible.iter().map(|&splat| (row(splat), splat as usize)).collect());
        Self { world, rows, by_row }
    }

    /// The model's row of the splat at `index`.
    pub fn row(&self, index: usize) -> u32 {
        self.rows.as_ref().map_or(index as u32, |rows| rows[index])
    }

    /// The position of the Gaussian in a row of the model, unless it is hidden at this time.
    pub fn of_row(&self, row: u32) -> Option<[f32; 3]> {
        let at = self.by_row.as_ref().map_or(Some(row as usize), |by_row| by_row.get(&row).copied())?;
        self.world.get(at).copied()
    }
}

impl Player {
    /// Reads the method's name and parameters from the model's header.
    pub fn new(model: &Model) -> anyhow::Result<Self> {
        let header = &model.header;
        let params: TrainingParams =
            serde_json::from_value(header.method_params.clone()).context("the model's parameters")?;
        let method = params.build()?;
        let trained = header.iterations.iter().rev().find(|(_, steps)| *steps > 0);
        let (phase, _) = trained.context("the model was not trained in any phase")?;
        let scene = SceneFacts {
            extent: header.scene_extent,
            unit_world: header.unit_world,
            time_map: header.time_map,
            background: header.background,
            time_count: header.time_count,
        };
        let state = ModelState::from_named(&model.tensors);
        let prompt_names = header.prompts.clone();
        let (device, phase) = (Device::Cpu, phase.clone());
        let (sh_degree, capacity) = (header.sh_degree, AtomicUsize::new(0));
        Ok(Self { method, state, prompt_names, scene, device, phase, sh_degree, capacity, edit: None })
    }

    /// Moves the player's computations to a device.
    pub fn on(self, device: Device) -> Self {
        Self { device, ..self }
    }

    /// An empty tape on the player's device.
    pub fn tape(&self) -> Tape<f32> {
        let tape = Tape::new(self.device);
        match self.capacity.load(Ordering::Relaxed) {
            0 => tape,
            most => tape.with_capacity(most),
        }
    }

    /// The Gaussians at a time of the capture for a camera, in the parametrisation of 3D Gaussian splatting files.
    pub fn gaussians(&self, time_secs: f64, camera: &PinholeCamera) -> anyhow::Result<Gaussians> {
        let mut tape = self.tape();
        let splats = self.splats(&mut tape, time_secs, camera)?;
        Ok(baked(&tape, &splats, self.sh_degree))
    }

    /// Motion model only: the Gaussians at a time, on a tape, with the edit if there is one.
    pub fn splats(&self, tape: &mut Tape<f32>, time_secs: f64, camera: &PinholeCamera) -> anyhow::Result<SplatVars> {
        let model = self.state.bind(tape, |_| false);
        let splats = self.method.splats(tape, &model, &self.moment(time_secs, camera))?;
        match &self.edit {
            Some(edit) => edit.apply(tape, splats),
            None => Ok(splats),
        }
    }

    /// The first and the last second of the capture.
    pub fn time_range_secs(&self) -> [f64; 2] {
        [self.scene.time_map.start_secs, self.scene.time_map.end_secs]
    }

    /// The positions of the Gaussians at a time, with their rows.
    pub fn positions(&self, time_secs: f64, camera: &PinholeCamera) -> anyhow::Result<Positions> {
        let mut tape = self.tape();
        let model = self.state.bind(&mut tape, |_| false);
        let moment = self.moment(time_secs, camera);
        let splats = self.method.splats(&mut tape, &model, &moment)?;
        let rows = self.method.rows(&mut tape, &model, &moment)?;
        let world = tape.value(splats.positions).as_slice().as_chunks().0.to_vec();
        Ok(Positions::new(world, rows, &present(&tape, &splats)))
    }

    fn moment<'m>(&'m self, time_secs: f64, camera: &'m PinholeCamera) -> Moment<'m> {
        let time = self.scene.time_map.normalized(time_secs);
        Moment { scene: &self.scene, phase: &self.phase, time, camera, sh_degree: self.sh_degree, left_out: None }
    }

    /// Rasterises splats. A splat that is not finite is an error, because an image without it would look like a worse
    /// model.
    pub fn rasterize(
        &self,
        tape: &mut Tape<f32>,
        splats: &SplatVars,
        features: Option<Var>,
        camera: &PinholeCamera,
        settings: &RasterSettings,
    ) -> anyhow::Result<Rendered> {
        let mut rendered = rasteriser::render(tape, splats, features, camera, settings).map_err(too_large)?;
        let mut found = tape.read_back();
        if !self.had_capacity(&found) {
            tape.clear_capacity();
            rendered = rasteriser::render(tape, splats, features, camera, settings).map_err(too_large)?;
            found = tape.read_back();
            self.had_capacity(&found);
        }
        // `found` has the GPU's events of the last render; the profile of the tape also has those of a first render
        // that overflowed, and those that the CPU counts.
        require_finite(&found.events)?;
        require_finite(&tape.profile().events)?;
        Ok(rendered)
    }

    /// Raises the capacity to the number of intersections of a render, and returns whether the render fitted into its
    /// buffers.
    fn had_capacity(&self, found: &Readback) -> bool {
        self.capacity.fetch_max(found.intersections, Ordering::Relaxed);
        !found.overflowed
    }

    /// [H, W, 3] colour at a time of the capture.
    pub fn render(&self, time_secs: f64, camera: &PinholeCamera) -> anyhow::Result<Tensor<f32>> {
        let mut tape = self.tape();
        let splats = self.splats(&mut tape, time_secs, camera)?;
        let rendered = self.rasterize(&mut tape, &splats, None, camera, &self.raster_settings())?;
        Ok(tape.value(rendered.color).clone())
    }

    /// The rasteriser's settings for this model.
    pub fn raster_settings(&self) -> RasterSettings {
        raster_settings(&self.scene, self.sh_degree)
    }
}

/// An error if a render met a splat that is not finite.
fn require_finite(events: &BTreeMap<&'static str, u64>) -> anyhow::Result<()> {
    let Some(count) = events.get(rasteriser::NOT_FINITE) else { return Ok(()) };
    let message = format!("a value of {count} splats is not finite");
    Err(Failure::new(FailureKind::Diverged, message).into())
}

//! A trained model put to use: Gaussians and images at any time, from any camera.

use anyhow::Context as _;
use scene::Gaussians;
use shaders::splat::{self, PinholeCamera, RasterSettings, Rendered, SplatVars};
use shaders::tape::{Device, Tape, Tensor};

use crate::artifact::Model;
use crate::bases::gaussians::baked;
use crate::method::{Method, Moment, SceneFacts, raster_settings, too_large};
use crate::methods;
use crate::params::TrainingParams;
use crate::state::ModelState;

/// A model with its method, ready to render.
pub struct Player {
    method: Box<dyn Method<f32>>,
    state: ModelState<f32>,
    scene: SceneFacts,
    phase: String,
    sh_degree: usize,
}

impl Player {
    /// Reads the method's name and parameters from the model's header.
    pub fn new(model: &Model) -> anyhow::Result<Self> {
        let header = &model.header;
        let params: TrainingParams =
            serde_json::from_value(header.method_params.clone()).context("the model's parameters")?;
        let method = methods::find(&params.method).map_err(anyhow::Error::msg)?.build_f32(&params)?;
        let trained = header.iterations.iter().rev().find(|(_, steps)| *steps > 0);
        let (phase, _) = trained.context("the model was not trained in any phase")?;
        let scene = SceneFacts {
            extent: header.scene_extent,
            time_map: header.time_map,
            background: header.background,
            time_count: header.time_count,
        };
        let state = ModelState::from_named(&model.tensors);
        Ok(Self { method, state, scene, phase: phase.clone(), sh_degree: header.sh_degree })
    }

    /// The Gaussians at a time of the capture as a camera sees them, in the usual parametrisation.
    pub fn gaussians(&self, time_secs: f64, camera: &PinholeCamera) -> anyhow::Result<Gaussians> {
        let mut tape = Tape::new(Device::Cpu);
        let splats = self.splats(&mut tape, time_secs, camera)?;
        Ok(baked(&tape, &splats, self.sh_degree))
    }

    /// Motion model only: the Gaussians at a time, on a tape.
    pub fn splats(&self, tape: &mut Tape<f32>, time_secs: f64, camera: &PinholeCamera) -> anyhow::Result<SplatVars> {
        let model = self.state.bind(tape, |_| false);
        let time = self.scene.time_map.normalized(time_secs);
        let moment = Moment { scene: &self.scene, phase: &self.phase, time, camera, sh_degree: self.sh_degree };
        self.method.splats(tape, &model, &moment)
    }

    /// Rasterisation only.
    pub fn rasterize(
        &self,
        tape: &mut Tape<f32>,
        splats: &SplatVars,
        camera: &PinholeCamera,
        settings: &RasterSettings,
    ) -> anyhow::Result<Rendered> {
        Ok(splat::render(tape, splats, None, camera, settings).map_err(too_large)?)
    }

    /// [H, W, 3] colour at a time of the capture.
    pub fn render(&self, time_secs: f64, camera: &PinholeCamera) -> anyhow::Result<Tensor<f32>> {
        let mut tape = Tape::new(Device::Cpu);
        let splats = self.splats(&mut tape, time_secs, camera)?;
        let rendered = self.rasterize(&mut tape, &splats, camera, &self.raster_settings())?;
        Ok(tape.value(rendered.color).clone())
    }

    /// How the model is rasterised.
    pub fn raster_settings(&self) -> RasterSettings {
        raster_settings(&self.scene, self.sh_degree)
    }
}

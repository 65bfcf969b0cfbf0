//! The contract between the trainer and the methods.
//!
//! The trainer knows phases, tensors by name, losses by name and step hooks; their meaning is up to the method.
//! Everything is generic over the precision, so a whole step can be checked in f64.

mod attention;
mod gradient_norms;
mod hooks;
mod language;
mod loss_units;
mod named_loss;
mod screen;
mod silhouette;
mod step;

pub(crate) use attention::{SEED_LIVES, is_seed};
pub(crate) use gradient_norms::{NormKeys, gradient_norms};
pub(crate) use hooks::{AfterStep, Detail, StepHook, Survey};
pub(crate) use language::Language;
pub(crate) use loss_units::LossUnits;
pub(crate) use named_loss::NamedLoss;
pub(crate) use screen::{Parents, ScreenGradients, ScreenStats};
pub(crate) use silhouette::SILHOUETTE;
#[cfg(test)]
pub(crate) use step::RenderRecord;
pub(crate) use step::{
    Observed, ParentVars, Recorded, SkippedWork, SplatRows, Step, StepOutcome, add_processed, run_step, sum_by_name,
};

use std::collections::BTreeMap;

use engine::{Failure, FailureKind};
use scene::cloud::PointCloud;
use serde_json::Value;
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::{RasterSettings, SplatVars, TooManyIntersections};
use shaders::tape::{Real, Tape};

use crate::data::{Dataset, SceneFacts, Streams, Supplements};
use crate::model::{ModelState, Variables};
use crate::schedule::{LogLinear, Phase};
use crate::shared::Shared;

/// A time, a camera and a stage of the training at which the model is evaluated.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment<'a> {
    /// The scene.
    pub scene: &'a SceneFacts,
    /// The phase's name; after training the last one.
    pub phase: &'a str,
    /// Normalised time in [0, 1].
    pub time: f64,
    /// The camera, for colours and anchors that depend on the viewpoint.
    pub camera: &'a PinholeCamera,
    /// Spherical-harmonics degree in use.
    pub sh_degree: usize,
    /// Normalised time of the training view whose seeds are left out, so that the seeds of its neighbours must represent
    /// it, as they must between two frames. With noise on the time, it differs from `time`.
    pub left_out: Option<f64>,
}

/// The inputs of a training.
#[derive(Clone, Copy)]
pub(crate) struct Start<'a> {
    /// The training views and the scene.
    pub dataset: &'a Dataset,
    /// The optional inputs.
    pub supplements: &'a Supplements,
}

impl<'a> Start<'a> {
    /// The facts of the scene that methods may read.
    pub(crate) fn scene(&self) -> &'a SceneFacts {
        &self.dataset.scene
    }

    /// The points of the first Gaussians.
    pub(crate) fn initial_points(&self, shared: &Shared) -> anyhow::Result<PointCloud> {
        self.dataset.initial_points(&shared.initial_points, shared.seed)
    }
}

/// A kind of model and its standard training, shared by the methods that build on it. A base depends on no method.
pub(crate) trait Base<T: Real>: Send + Sync {
    /// The phases in order.
    fn phases(&self) -> Vec<Phase>;

    /// The initial values of every tensor.
    fn initialize(&self, start: &Start<'_>, points: &PointCloud, random: Streams) -> anyhow::Result<ModelState<T>>;

    /// Changes the state at the start of a phase, e.g. adds tensors. The default changes nothing.
    fn enter_phase(
        &self,
        _phase: &str,
        state: ModelState<T>,
        _start: &Start<'_>,
        _random: Streams,
    ) -> anyhow::Result<ModelState<T>> {
        Ok(state)
    }

    /// The learning rate of a tensor in a phase; `None` for a tensor that is not trained.
    fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear>;

    /// The Gaussians at one moment: the motion model. Gaussians that do not exist at that moment have the opacity
    /// [`HIDDEN_LOGIT`](shaders::rasteriser::HIDDEN_LOGIT).
    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars>;

    /// The rows of the model that [`Base::splats`] returns, if they change with the moment; `None`: all rows in order.
    fn rows(&self, _tape: &mut Tape<T>, _model: &Variables, _moment: &Moment<'_>) -> anyhow::Result<Option<Vec<u32>>> {
        Ok(None)
    }

    /// The step hooks of a phase, e.g. density control.
    fn hooks(&self, _phase: &str, _scene: &SceneFacts) -> Vec<Box<dyn StepHook>> {
        Vec::new()
    }
}

/// A method of dynamic (or static) Gaussian splatting: a base and the differences from it. By default, every call is
/// forwarded to the base and the loss is photometric.
pub(crate) trait Method<T: Real>: Send + Sync {
    /// The base; the method itself, if it builds on none of [`crate::bases`].
    fn base(&self) -> &dyn Base<T>;

    /// The phases in order.
    fn phases(&self) -> Vec<Phase> {
        self.base().phases()
    }

    /// The initial values of every tensor.
    fn initialize(&self, start: &Start<'_>, points: &PointCloud, random: Streams) -> anyhow::Result<ModelState<T>> {
        self.base().initialize(start, points, random)
    }

    /// Changes the state at the start of a phase (adds tensors, selects nodes).
    fn enter_phase(
        &self,
        phase: &str,
        state: ModelState<T>,
        start: &Start<'_>,
        random: Streams,
    ) -> anyhow::Result<ModelState<T>> {
        self.base().enter_phase(phase, state, start, random)
    }

    /// The learning rate of a tensor in a phase; `None` for a tensor that is not trained.
    fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        self.base().learning_rate(phase, tensor, scene)
    }

    /// The Gaussians at one moment, as [`Base::splats`] defines them.
    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        self.base().splats(tape, model, moment)
    }

    /// The rows of the model that [`Method::splats`] returns, if they change with the moment; `None`: all rows in
    /// order.
    fn rows(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<Option<Vec<u32>>> {
        self.base().rows(tape, model, moment)
    }

    /// The step hooks of a phase, e.g. density control.
    fn hooks(&self, phase: &str, scene: &SceneFacts) -> Vec<Box<dyn StepHook>> {
        self.base().hooks(phase, scene)
    }

    /// Adds the losses of one step ([`Step::add_loss`]); by default the photometric loss of every view.
    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        photometric_losses(self, step)
    }

    /// Values that the parts of the method report about the trained model, by name.
    fn figures(&self, _tape: &mut Tape<T>, _model: &Variables, _scene: &SceneFacts) -> BTreeMap<String, f64> {
        BTreeMap::new()
    }

    /// Semantic features of the Gaussians, for the methods that have them.
    fn language(&self) -> Option<&dyn Language<T>> {
        None
    }
}

/// Renders every view of the step and compares it with its image.
pub(crate) fn photometric_losses<T: Real, M: Method<T> + ?Sized>(
    method: &M,
    step: &mut Step<'_, T>,
) -> anyhow::Result<()> {
    for view in step.views {
        step.clock.enter("motion");
        let moment = step.moment(view);
        let splats = method.splats(step.tape, step.model, &moment)?;
        step.compare(&splats, view, Observed::All("gaussians"))?;
    }
    Ok(())
}

/// The first phases of a method up to one of them, as far as the tables of all methods do not determine them. Trainings
/// with equal values can continue from one model.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SharedPhase {
    /// The base of the phases, e.g. `hexplane`: phases of different bases are never equal.
    pub base: &'static str,
    /// The name of the last of them.
    pub phase: &'static str,
    /// The part of the method's own table that they read.
    pub settings: Value,
    /// The iterations of these phases, before stretching.
    pub iterations: BTreeMap<&'static str, u64>,
    /// The effects that change them.
    pub effects: &'static [&'static str],
    /// The losses besides the photometric one that act in them.
    pub losses: &'static [&'static str],
}

/// The failure of a render whose Gaussians cover too much of the image.
pub(crate) fn too_large(error: TooManyIntersections) -> Failure {
    Failure::new(FailureKind::Diverged, error.to_string())
}

/// Gaussians nearer than this are not drawn, in [`SceneFacts::unit_world`] (Kerbl et al. 2023).
const NEAR_VIEW: f64 = 0.2;

/// The rasteriser settings of every render of a model of this scene, during and after training.
pub(crate) fn raster_settings(scene: &SceneFacts, sh_degree: usize) -> RasterSettings {
    let near_view = NEAR_VIEW * scene.unit_world;
    RasterSettings { background: scene.background, sh_degree, near_view, ..RasterSettings::default() }
}

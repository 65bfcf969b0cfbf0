//! What a method is; [`Step`] is what one training step offers it.
//!
//! The trainer knows phases, tensors by name, losses by name and populations whose rows come and go; what they mean is
//! the method's business. Everything is generic over the precision, so that a whole step is checked in f64.

use engine::{Failure, FailureKind};
use rand_chacha::ChaCha8Rng;
use scene::TimeMap;
use scene::cloud::PointCloud;
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::{RasterSettings, SplatVars, TooManyIntersections};
use shaders::tape::{Real, Tape, Tensor};

use crate::dataset::Dataset;
use crate::language::Language;
use crate::optimizer::Optimizer;
use crate::params::Shared;
use crate::schedule::LogLinear;
use crate::screen::Screen;
use crate::state::{ModelState, Variables};
use crate::step::Step;
use crate::supplements::Supplements;

/// One phase of a training: it starts with a fresh optimiser and ends with a [`ModelState`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Phase {
    /// As `coarse`; the key of [`Shared::iterations`].
    pub name: &'static str,
    /// Optimiser steps.
    pub iterations: u64,
}

/// What a method may know of the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFacts {
    /// 1.1 × the largest distance of a training camera from their mean, scene units.
    pub extent: f64,
    /// Seconds to [0, 1].
    pub time_map: TimeMap,
    /// The colour behind the Gaussians.
    pub background: [f32; 3],
    /// Different times among the training views.
    pub time_count: usize,
}

/// When, whence and how far in training the model is looked at.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// The scene.
    pub scene: &'a SceneFacts,
    /// The phase's name; after training the last one.
    pub phase: &'a str,
    /// In [0, 1].
    pub time: f64,
    /// The camera that looks, for what depends on the viewpoint.
    pub camera: &'a PinholeCamera,
    /// Spherical-harmonics degree in use.
    pub sh_degree: usize,
}

/// One training view in the working precision.
#[derive(Clone, Debug)]
pub struct TrainingView<T: Real> {
    /// Index within the capture's views.
    pub index: usize,
    /// Intrinsics and pose.
    pub camera: PinholeCamera,
    /// In [0, 1].
    pub time: f64,
    /// [H, W, 3] in [0, 1].
    pub image: Tensor<T>,
}

/// What a training starts from.
#[derive(Clone, Copy)]
pub struct Start<'a> {
    /// The training views and the scene's facts.
    pub dataset: &'a Dataset,
    /// What the optional inputs gave.
    pub supplements: &'a Supplements,
}

impl<'a> Start<'a> {
    /// What a method may know of the scene.
    pub fn scene(&self) -> &'a SceneFacts {
        &self.dataset.scene
    }

    /// The points that Gaussians start on.
    pub fn initial_points(&self, shared: &Shared) -> anyhow::Result<PointCloud> {
        self.dataset.initial_points(&shared.initial_points, shared.seed)
    }
}

/// A method of dynamic (or static) Gaussian splatting.
pub trait Method<T: Real>: Send + Sync {
    /// The phases in order.
    fn phases(&self) -> Vec<Phase>;

    /// The first values of every tensor.
    fn initialize(
        &self,
        start: &Start<'_>,
        points: &PointCloud,
        random: &mut ChaCha8Rng,
    ) -> anyhow::Result<ModelState<T>>;

    /// Changes the state at the start of a phase (adds tensors, selects nodes); most methods change nothing.
    fn enter_phase(
        &self,
        _phase: &str,
        state: ModelState<T>,
        _start: &Start<'_>,
        _random: &mut ChaCha8Rng,
    ) -> anyhow::Result<ModelState<T>> {
        Ok(state)
    }

    /// The step size of a tensor in a phase; `None` where it is not learnt.
    fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear>;

    /// The Gaussians at one moment: the motion model. Those that are not there then have the opacity
    /// [`shaders::rasteriser::HIDDEN_LOGIT`].
    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars>;

    /// Which rows of the model [`Method::splats`] returns at a moment, where that changes with the moment; `None`: all
    /// of them, in order.
    fn rows(&self, _tape: &mut Tape<T>, _model: &Variables, _moment: &Moment<'_>) -> anyhow::Result<Option<Vec<u32>>> {
        Ok(None)
    }

    /// The losses of one step, given to [`Step::add_loss`]; by default the photometric loss of the step's views.
    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        photometric_losses(self, step)
    }

    /// What makes and removes rows during a phase.
    fn population_controls(&self, _phase: &str, _scene: &SceneFacts) -> Vec<Box<dyn PopulationControl>> {
        Vec::new()
    }

    /// What the model knows of its Gaussians in words; most methods know nothing.
    fn language(&self) -> Option<&dyn Language<T>> {
        None
    }
}

/// Renders every view of the step and compares it with its image: what most methods start from.
pub fn photometric_losses<T: Real, M: Method<T> + ?Sized>(method: &M, step: &mut Step<'_, T>) -> anyhow::Result<()> {
    for view in step.views {
        step.clock.enter("motion");
        let moment = step.moment(view);
        let splats = method.splats(step.tape, step.model, &moment)?;
        let rendered = step.render(&splats, None, view, Some("gaussians"))?;
        step.photometric(rendered.color, view);
    }
    Ok(())
}

/// What every control has that can be cloned.
pub trait BoxedClone {
    /// The same control once more, as it is now.
    fn boxed_clone(&self) -> Box<dyn PopulationControl>;
}

impl<C: PopulationControl + Clone + 'static> BoxedClone for C {
    fn boxed_clone(&self) -> Box<dyn PopulationControl> {
        Box::new(self.clone())
    }
}

/// Makes and removes rows of a population between steps. Its state is part of every checkpoint.
pub trait PopulationControl: BoxedClone + Send {
    /// Whether the step `iteration` (counted from 1) is to be observed.
    fn watches(&self, iteration: u64) -> bool;

    /// Watches one step.
    fn observe(&mut self, screen: &Screen<'_>);

    /// Whether [`PopulationControl::act`] judges rows after the step `iteration`, and so must know them.
    fn judges(&self, iteration: u64) -> bool;

    /// Acts after the optimiser's step `iteration`.
    fn act(
        &mut self,
        iteration: u64,
        optimizer: &mut Optimizer,
        scene: &SceneFacts,
        random: &mut ChaCha8Rng,
    ) -> anyhow::Result<()>;

    /// The statistics, for a checkpoint.
    fn save(&self) -> serde_json::Value;

    /// The statistics from a checkpoint.
    fn restore(&mut self, saved: serde_json::Value) -> anyhow::Result<()>;
}

/// The failure of a render whose Gaussians cover too much of the image.
pub fn too_large(error: TooManyIntersections) -> Failure {
    Failure::new(FailureKind::Diverged, error.to_string())
}

/// Nearer Gaussians are not drawn, scene units (Kerbl et al. 2023).
const NEAR_VIEW: f64 = 0.2;

/// How every stage rasterises a model of this scene.
pub fn raster_settings(scene: &SceneFacts, sh_degree: usize) -> RasterSettings {
    RasterSettings { background: scene.background, sh_degree, near_view: NEAR_VIEW, ..RasterSettings::default() }
}

//! What a method is, and what one training step offers it.
//!
//! The trainer knows phases, tensors by name, losses by name and populations whose rows come and go; what they mean is
//! the method's business. Everything is generic over the precision, so that a whole step is checked in f64.

use std::collections::BTreeMap;
use std::sync::Arc;

use engine::{Failure, FailureKind};
use rand_chacha::ChaCha8Rng;
use scene::TimeMap;
use scene::cloud::PointCloud;
use shaders::losses::l1_dssim;
use shaders::splat::{self, PinholeCamera, RasterSettings, Rendered, SplatVars, TooManyIntersections};
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::clock::PhaseClock;
use crate::dataset::Dataset;
use crate::language::Language;
use crate::optimizer::Optimizer;
use crate::params::Shared;
use crate::schedule::LogLinear;
use crate::screen::Screen;
use crate::state::{ModelState, Variables};
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
    /// [`splat::HIDDEN_LOGIT`].
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

/// Which rows of a population the splats of a render are that a network made of its owners' places, for this render alone.
#[derive(Clone, Debug)]
pub struct SplatRows {
    /// As `anchors`.
    pub population: &'static str,
    /// The number of rows.
    pub count: usize,
    /// [M] the row of each splat, each at most once; `None`: they are all rows in order.
    pub row_of_splat: Option<Arc<Vec<u32>>>,
    /// What owns the rows.
    pub owners: OwnerVars,
}

/// What a render says about N owners of splats, each of equally many rows.
#[derive(Clone, Copy, Debug)]
pub struct OwnerVars {
    /// [N, 1]: 1 where the render looks at the owner, drawn or not, else 0.
    pub in_view: Var,
    /// [N, 1]: the sum of the opacities of its splats.
    pub opacity: Var,
}

/// One loss of a step: a scalar on the tape and its weight in the sum.
#[derive(Clone, Debug)]
pub struct NamedLoss {
    /// As `l1`.
    pub name: &'static str,
    /// Its factor in the sum.
    pub weight: f64,
    /// A scalar.
    pub value: Var,
}

/// A render whose screen gradients drive a population.
pub(crate) struct WatchedRender {
    pub population: String,
    pub rendered: Rendered,
    pub size_px: [f64; 2],
    /// Rows of the population: the first splats, unless `rows` tells which.
    pub count: usize,
    /// Which rows the splats are; `None`: the first ones are all rows in order.
    pub rows: Option<SplatRows>,
}

/// One training step as a method sees it.
pub struct Step<'a, T: Real> {
    /// Records everything.
    pub tape: &'a mut Tape<T>,
    /// The model's tensors on the tape.
    pub model: &'a Variables,
    /// The views drawn for this step.
    pub views: &'a [TrainingView<T>],
    /// The scene.
    pub scene: &'a SceneFacts,
    /// All training views, for what looks at more than this step's.
    pub dataset: &'a Dataset,
    /// What the optional inputs gave.
    pub supplements: &'a Supplements,
    /// The tables that every method understands.
    pub shared: &'a Shared,
    /// The phase's name.
    pub phase: &'a str,
    /// Counted from 1 within the phase.
    pub iteration: u64,
    /// Spherical-harmonics degree in use.
    pub sh_degree: usize,
    /// How renders are rasterised.
    pub raster: RasterSettings,
    /// The method's own random draws.
    pub random: &'a mut ChaCha8Rng,
    /// Where the time goes.
    pub clock: &'a mut PhaseClock,
    pub(crate) losses: Vec<NamedLoss>,
    pub(crate) renders: Vec<WatchedRender>,
    pub(crate) skipped: SkippedWork,
    pub(crate) kept: Vec<KeptWork>,
}

/// What was not left out of so much: a scalar on the tape, which is looked at later.
pub(crate) type KeptWork = (&'static str, Var, usize);

/// Work left out because nothing called for it: by name, how much of how much.
pub type SkippedWork = BTreeMap<&'static str, [u64; 2]>;

impl<'a, T: Real> Step<'a, T> {
    /// The moment of a view in this step.
    pub fn moment(&self, view: &'a TrainingView<T>) -> Moment<'a> {
        Moment {
            scene: self.scene,
            phase: self.phase,
            time: view.time,
            camera: &view.camera,
            sh_degree: self.sh_degree,
        }
    }

    /// Renders Gaussians, and `features` [N, F] with them, as a view's camera sees them; `population` names the rows
    /// that the screen gradients drive.
    pub fn render(
        &mut self,
        splats: &SplatVars,
        features: Option<Var>,
        view: &TrainingView<T>,
        population: Option<&str>,
    ) -> anyhow::Result<Rendered> {
        let rendered = self.rasterize(splats, features, view)?;
        if let Some(population) = population {
            let count = rendered.splats(self.tape);
            self.watch(&rendered, count, view, population, None);
        }
        Ok(rendered)
    }

    /// As [`Step::render`] where the population is the `count` first splats.
    pub fn render_first(
        &mut self,
        splats: &SplatVars,
        count: usize,
        view: &TrainingView<T>,
        population: &str,
    ) -> anyhow::Result<Rendered> {
        let rendered = self.rasterize(splats, None, view)?;
        self.watch(&rendered, count, view, population, None);
        Ok(rendered)
    }

    /// As [`Step::render`] for splats that are some rows of a population.
    pub fn render_rows(
        &mut self,
        splats: &SplatVars,
        view: &TrainingView<T>,
        rows: SplatRows,
    ) -> anyhow::Result<Rendered> {
        let rendered = self.rasterize(splats, None, view)?;
        let (population, count) = (rows.population, rows.count);
        self.watch(&rendered, count, view, population, Some(rows));
        Ok(rendered)
    }

    fn rasterize(
        &mut self,
        splats: &SplatVars,
        features: Option<Var>,
        view: &TrainingView<T>,
    ) -> anyhow::Result<Rendered> {
        self.clock.enter("render");
        let rendered = splat::render(self.tape, splats, features, &view.camera, &self.raster).map_err(too_large)?;
        self.clock.enter("losses");
        Ok(rendered)
    }

    /// Keeps what a render says about a population for its control.
    fn watch(
        &mut self,
        rendered: &Rendered,
        count: usize,
        view: &TrainingView<T>,
        population: &str,
        rows: Option<SplatRows>,
    ) {
        self.renders.push(WatchedRender {
            population: population.into(),
            rendered: rendered.clone(),
            count,
            size_px: [view.camera.width as f64, view.camera.height as f64],
            rows,
        });
    }

    /// (1 − λ)·L1 + λ·(1 − SSIM) of a render against its view's image, averaged over the step's views.
    pub fn photometric(&mut self, color: Var, view: &TrainingView<T>) {
        self.clock.enter("loss photometric");
        let share = 1.0 / self.views.len() as f64;
        let target = self.tape.constant(view.image.clone());
        let value = l1_dssim(self.tape, color, target, self.shared.loss.lambda_dssim);
        self.add_loss("photometric", share, value);
        self.clock.enter("losses");
    }

    /// Counts work that was left out because nothing called for it, as `("motion of static Gaussians", 900, 1000)`.
    pub fn count_skipped(&mut self, what: &'static str, skipped: usize, of: usize) {
        let count = self.skipped.entry(what).or_default();
        count[0] += skipped as u64;
        count[1] += of as u64;
    }

    /// The same where only the tape knows how much was `kept`, a scalar: nobody waits for it.
    pub fn count_skipped_later(&mut self, what: &'static str, kept: Var, of: usize) {
        self.kept.push((what, kept, of));
    }

    /// Adds `weight` · `value` to what is minimised.
    pub fn add_loss(&mut self, name: &'static str, weight: f64, value: Var) {
        self.losses.push(NamedLoss { name, weight, value });
    }
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

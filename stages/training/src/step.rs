//! One training step: what a method sees of it, and its forward and backward pass, in any precision.

use std::collections::BTreeMap;
use std::sync::Arc;

use rand_chacha::ChaCha8Rng;
use shaders::losses::l1::l1_dssim;
use shaders::rasteriser::{self, RasterSettings, Rendered, SplatVars};
use shaders::tape::{Gradients, Real, Tape, Tensor, Var, first_elements};

use crate::clock::PhaseClock;
use crate::dataset::Dataset;
use crate::method::{Method, Moment, SceneFacts, TrainingView, too_large};
use crate::params::Shared;
use crate::state::Variables;
use crate::supplements::Supplements;
use crate::view_constants::ViewConstants;

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
    /// What is known of views from the start, on the step's device.
    pub(crate) constants: &'a ViewConstants<T>,
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
        let rendered =
            rasteriser::render(self.tape, splats, features, &view.camera, &self.raster).map_err(too_large)?;
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

/// What a step computed: its losses, its gradients and what its renders saw.
pub struct StepOutcome<T: Real> {
    /// Name, weight and value of every loss.
    pub values: Vec<(&'static str, f64, Tensor<T>)>,
    /// Gradients of the sum of the weighted losses by everything on the tape.
    pub gradients: Gradients<T>,
    /// What the step left out, as far as it is known.
    pub skipped: SkippedWork,
    /// How much of what it did not leave out, of how much.
    pub kept: Vec<(&'static str, Tensor<T>, usize)>,
    /// What drives populations.
    pub(crate) renders: Vec<WatchedRender>,
}

/// Evaluates a method's losses on a step and differentiates their sum.
pub fn run_step<T: Real>(method: &dyn Method<T>, mut step: Step<'_, T>) -> anyhow::Result<StepOutcome<T>> {
    method.losses(&mut step)?;
    step.clock.enter("backward");
    let seed = |loss: &NamedLoss| {
        let shape = step.tape.value(loss.value).shape().to_vec();
        (loss.value, Tensor::full(shape, T::from_f64(loss.weight)))
    };
    let seeds: Vec<_> = step.losses.iter().map(seed).collect();
    let gradients = step.tape.backward(&seeds);
    let value = |loss: &NamedLoss| (loss.name, loss.weight, step.tape.value(loss.value).clone());
    let values = step.losses.iter().map(value).collect();
    let kept = step.kept.iter().map(|&(what, kept, of)| (what, step.tape.value(kept).clone(), of)).collect();
    Ok(StepOutcome { values, gradients, skipped: step.skipped, kept, renders: step.renders })
}

impl<T: Real> StepOutcome<T> {
    /// Weighted losses by name, summed over views, and all that was left out; a GPU is waited for.
    pub fn look(&self) -> (BTreeMap<&'static str, f64>, SkippedWork) {
        let losses = self.values.iter().map(|(.., value)| value);
        let tensors: Vec<&Tensor<T>> = losses.chain(self.kept.iter().map(|(_, kept, _)| kept)).collect();
        let mut values = first_elements(&tensors).into_iter().map(T::to_f64);
        let weights = self.values.iter().map(|(name, weight, _)| (*name, *weight));
        let losses = sum_by_name(weights.zip(values.by_ref()));
        let mut skipped = self.skipped.clone();
        for ((what, _, of), kept) in self.kept.iter().zip(values) {
            add_kept(&mut skipped, what, kept, *of);
        }
        (losses, skipped)
    }

    /// Weighted losses by name, summed over views; a GPU is waited for.
    pub fn losses(&self) -> BTreeMap<&'static str, f64> {
        self.look().0
    }

    /// The sum of the weighted losses; a GPU is waited for.
    pub fn total(&self) -> f64 {
        self.losses().values().sum()
    }
}

/// Counts what was left out where `kept` of so much was not: a whole number, but for rounding.
pub fn add_kept(skipped: &mut SkippedWork, what: &'static str, kept: f64, of: usize) {
    let [left_out, all] = skipped.entry(what).or_default();
    *left_out += of as u64 - kept.round() as u64;
    *all += of as u64;
}

/// Weighted values by name.
pub fn sum_by_name(losses: impl Iterator<Item = ((&'static str, f64), f64)>) -> BTreeMap<&'static str, f64> {
    let mut sums = BTreeMap::new();
    losses.for_each(|((name, weight), value)| *sums.entry(name).or_default() += weight * value);
    sums
}

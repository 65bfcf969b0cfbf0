//! Steps that a GPU is asked for without waiting, and what becomes of them when somebody looks.
//!
//! Nothing of such a step is read back until many of them are, or until somebody needs to be certain: a population control
//! that judges rows, a point of the curve, a checkpoint, the end of a phase. If a figure was not finite then, or a render
//! had more intersections than there was room for, the training goes back to before the first of these steps and makes
//! them again one by one, watching each: a failure then shows where it arises, and a lack of room never has an effect.

use rand_chacha::ChaCha8Rng;
use shaders::rasteriser::NOT_FINITE;
use shaders::tape::{PendingReadback, Profile, Readback};

use super::Trainer;
use crate::method::PopulationControl;
use crate::optimizer::Optimizer;
use crate::sampler::ViewSampler;
use crate::step::{SkippedWork, add_kept, sum_by_name};

/// Steps after which somebody looks: waiting for one in so many costs nothing to speak of, and little is done in vain.
const MOST_AHEAD: usize = 32;
/// Renders have room for so many times the intersections of any render so far.
const MARGIN: f64 = 1.25;
/// And for so many more, as a few Gaussians can multiply.
const LEAST_ROOM: usize = 1 << 14;

/// Steps that nobody has looked at.
pub struct Ahead {
    before: Moment,
    steps: Vec<LaterStep>,
}

/// What a step will tell.
pub struct LaterStep {
    /// Name and weight of every loss.
    pub losses: Vec<(&'static str, f64)>,
    /// What some work is called, and how much there was to do.
    pub kept: Vec<(&'static str, usize)>,
    /// Tensors that were updated.
    pub gradients: Vec<String>,
    /// The value of every loss; how much of that work was done; then the largest magnitude of each gradient and of the tensor after the step.
    pub figures: PendingReadback,
}

/// Everything that steps change, before the first of them.
struct Moment {
    iteration: u64,
    sh_degree: usize,
    optimizer: Optimizer,
    controls: Vec<Box<dyn PopulationControl>>,
    sampler: ViewSampler,
    density_random: ChaCha8Rng,
    method_random: ChaCha8Rng,
    profile: Profile,
    skipped: SkippedWork,
}

/// Whether nothing of a step is left to ask.
fn is_good(found: &Readback) -> bool {
    let is_finite = found.values.iter().flatten().all(|value| value.is_finite());
    is_finite && !found.overflowed && !found.events.contains_key(NOT_FINITE)
}

impl Trainer<'_> {
    /// Renders to come have room for more intersections than this.
    pub(super) fn make_room(&mut self, intersections: usize) {
        let room = (MARGIN * intersections as f64) as usize + LEAST_ROOM;
        if self.device.gpu().is_some() {
            self.room = self.room.max(room);
        }
    }

    #[cfg(test)]
    pub(super) fn steps_ahead(&self) -> usize {
        self.ahead.as_ref().map_or(0, |ahead| ahead.steps.len())
    }

    /// Keeps what is now, unless there is something from before already.
    pub(super) fn remember(&mut self) {
        if self.ahead.is_none() {
            let before = Moment {
                iteration: self.iteration,
                sh_degree: self.sh_degree,
                optimizer: self.optimizer.clone(),
                controls: self.controls.iter().map(|control| control.boxed_clone()).collect(),
                sampler: self.sampler.clone(),
                density_random: self.density_random.clone(),
                method_random: self.method_random.clone(),
                profile: self.profile.clone(),
                skipped: self.skipped.clone(),
            };
            self.ahead = Some(Ahead { before, steps: Vec::new() });
        }
    }

    /// Adds a step that was made; whether the population controls may act after it (else they have).
    pub(super) fn look_later(&mut self, step: LaterStep) -> anyhow::Result<bool> {
        let ahead = self.ahead.as_mut().expect("it was remembered what was before");
        ahead.steps.push(step);
        let is_long = ahead.steps.len() >= MOST_AHEAD;
        if is_long || self.controls.iter().any(|control| control.judges(self.iteration)) {
            return self.look();
        }
        Ok(true)
    }

    /// Looks at every step so far.
    pub(super) fn settle(&mut self) -> anyhow::Result<()> {
        self.look().map(drop)
    }

    /// The same; whether all was well. If not, the steps are made again.
    fn look(&mut self) -> anyhow::Result<bool> {
        let Some(Ahead { before, steps }) = self.ahead.take() else { return Ok(true) };
        self.clock.enter("waiting for the device");
        let found = PendingReadback::read(steps.iter().map(|step| &step.figures));
        if !found.iter().all(is_good) {
            self.make_again(before)?;
            return Ok(false);
        }
        for (index, (step, found)) in steps.iter().zip(found).enumerate() {
            self.make_room(found.intersections);
            found.events.iter().for_each(|(what, count)| self.profile.count(what, *count));
            let (losses, rest) = found.values.split_at(step.losses.len());
            let values = losses.iter().map(|value| f64::from(value[0]));
            self.keep_losses(&sum_by_name(step.losses.iter().copied().zip(values)));
            let (kept, magnitudes) = rest.split_at(step.kept.len());
            for ((what, of), kept) in step.kept.iter().zip(kept) {
                add_kept(&mut self.skipped, what, f64::from(kept[0]), *of);
            }
            let of_gradients = magnitudes[0].chunks_exact(2).map(|figures| figures[0]);
            let gradients = step.gradients.iter().map(String::as_str).zip(of_gradients);
            self.keep_gradients(before.iteration + 1 + index as u64, gradients);
        }
        Ok(true)
    }

    /// Goes back and makes the steps since then again, up to the one that was begun last.
    pub(super) fn go_back(&mut self) -> anyhow::Result<()> {
        match self.ahead.take() {
            Some(Ahead { before, .. }) => self.make_again(before),
            None => Ok(()),
        }
    }

    fn make_again(&mut self, before: Moment) -> anyhow::Result<()> {
        let last = self.iteration;
        (self.iteration, self.sh_degree) = (before.iteration, before.sh_degree);
        (self.optimizer, self.controls, self.sampler) = (before.optimizer, before.controls, before.sampler);
        (self.density_random, self.method_random) = (before.density_random, before.method_random);
        (self.profile, self.skipped) = (before.profile, before.skipped);
        while self.iteration < last {
            self.watched_step()?;
        }
        Ok(())
    }
}

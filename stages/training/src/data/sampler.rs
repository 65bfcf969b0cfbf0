//! The order of the training views, and the random streams of a training.

use std::collections::BTreeMap;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

/// Draws views without replacement, epoch by epoch, in an order that the seed fixes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ViewSampler {
    count: usize,
    remaining: Vec<usize>,
    random: ChaCha8Rng,
}

impl ViewSampler {
    /// A sampler of `count` views (at least one).
    pub(crate) fn new(count: usize, random: ChaCha8Rng) -> Self {
        assert!(count > 0, "a sampler needs views");
        Self { count, remaining: Vec::new(), random }
    }

    /// The next view's index.
    pub(crate) fn next_view(&mut self) -> usize {
        if self.remaining.is_empty() {
            self.remaining = (0..self.count).collect();
        }
        let at = self.random.random_range(0..self.remaining.len() as u64) as usize;
        self.remaining.swap_remove(at)
    }
}

/// The independent random streams of one training. Each is keyed by its purpose, never by the number of earlier draws
/// or by the index of a phase: variants of a method that add a phase, a tensor or a loss change no other draw, so their
/// results are paired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Streams {
    seed: u64,
}

impl Streams {
    /// The streams of a training with this seed.
    pub(crate) const fn new(seed: u64) -> Self {
        Self { seed }
    }

    /// The initial values of a tensor.
    pub(crate) fn tensor(self, name: &str) -> ChaCha8Rng {
        self.keyed(&["tensor", name])
    }

    /// The order of the views in a phase.
    pub(crate) fn views(self, phase: &str) -> ChaCha8Rng {
        self.keyed(&["views", phase])
    }

    /// The draws within one step, counted from 1 within the phase.
    pub(crate) fn step(self, phase: &'static str, iteration: u64) -> StepRandom {
        StepRandom { streams: self, phase, iteration, drawn: BTreeMap::new() }
    }

    fn keyed(self, key: &[&str]) -> ChaCha8Rng {
        let mut hash = Sha256::new_with_prefix(self.seed.to_le_bytes());
        for part in key {
            hash.update((part.len() as u64).to_le_bytes());
            hash.update(part);
        }
        ChaCha8Rng::from_seed(hash.finalize().into())
    }
}

/// The random streams of one step. They depend on the phase and the iteration only, so a checkpoint holds none of them.
#[derive(Debug)]
pub(crate) struct StepRandom {
    streams: Streams,
    phase: &'static str,
    iteration: u64,
    drawn: BTreeMap<&'static str, ChaCha8Rng>,
}

impl StepRandom {
    /// The stream of a purpose, e.g. of one loss; within the step it continues from its last draw.
    pub(crate) fn of(&mut self, purpose: &'static str) -> &mut ChaCha8Rng {
        self.drawn.entry(purpose).or_insert_with(|| {
            let mut random = self.streams.keyed(&["step", self.phase, purpose]);
            random.set_stream(self.iteration);
            random
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_epoch_draws_every_view_once_in_a_new_order() {
        let mut sampler = ViewSampler::new(17, Streams::new(3).views("train"));
        let epochs: Vec<Vec<usize>> = (0..3).map(|_| (0..17).map(|_| sampler.next_view()).collect()).collect();
        for epoch in &epochs {
            let mut sorted = epoch.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..17).collect::<Vec<_>>());
        }
        assert_ne!(epochs[0], epochs[1]);
    }

    #[test]
    fn a_sampler_survives_serialisation() {
        let new = |seed| ViewSampler::new(9, Streams::new(seed).views("train"));
        let mut sampler = new(1);
        (0..5).for_each(|_| {
            sampler.next_view();
        });
        let mut copy: ViewSampler = serde_json::from_str(&serde_json::to_string(&sampler).unwrap()).unwrap();
        let draw = |sampler: &mut ViewSampler| (0..30).map(|_| sampler.next_view()).collect::<Vec<_>>();
        assert_eq!(draw(&mut sampler), draw(&mut copy));
        assert_ne!(draw(&mut new(1)), draw(&mut new(2)));
    }

    #[test]
    fn streams_differ_by_seed_purpose_phase_and_iteration() {
        let streams = Streams::new(3);
        let first = |mut random: ChaCha8Rng| random.random::<u64>();
        let in_step = |phase, iteration, purpose| first(streams.step(phase, iteration).of(purpose).clone());
        let drawn = [
            first(streams.tensor("fine")),
            first(streams.views("fine")),
            first(streams.views("coarse")),
            first(Streams::new(4).views("fine")),
            in_step("fine", 1, "noise"),
            in_step("fine", 2, "noise"),
            in_step("fine", 1, "rigidity"),
            in_step("coarse", 1, "noise"),
        ];
        assert_eq!(drawn.iter().collect::<std::collections::BTreeSet<_>>().len(), drawn.len());
        assert_eq!(in_step("fine", 1, "noise"), drawn[4]);
    }

    #[test]
    fn a_purpose_that_draws_more_changes_no_other_and_goes_on_within_its_step() {
        let mut step = Streams::new(3).step("fine", 7);
        let noise: [u64; 2] = [step.of("noise").random(), step.of("noise").random()];
        let mut other = Streams::new(3).step("fine", 7);
        other.of("rigidity").random::<[u64; 9]>();
        assert_eq!([other.of("noise").random::<u64>(), other.of("noise").random()], noise);
        assert_ne!(noise[0], noise[1]);
    }
}

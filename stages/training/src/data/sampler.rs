//! The order of the training views, and the random streams of a training.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

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

/// The independent random streams of one training.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Stream {
    /// First values of the parameters.
    Initial = 0,
    /// Order of the views.
    Views = 1,
    /// Positions of split Gaussians.
    Density = 2,
    /// Draws of a method within its steps.
    Method = 3,
}

/// Streams per phase; more than there are kinds, so that adding a kind changes no other stream.
const STREAMS_PER_PHASE: u64 = 16;

/// The generator of one stream at the start of a training.
pub(crate) fn generator(seed: u64, stream: Stream) -> ChaCha8Rng {
    phase_generator(seed, stream, 0)
}

/// The generator of one stream at the start of a phase (counted from 0). It does not depend on how many numbers earlier
/// phases drew, or on which job ran them.
pub(crate) fn phase_generator(seed: u64, stream: Stream, phase: usize) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(STREAMS_PER_PHASE * phase as u64 + stream as u64);
    random
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_epoch_draws_every_view_once_in_a_new_order() {
        let mut sampler = ViewSampler::new(17, generator(3, Stream::Views));
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
        let new = |seed| ViewSampler::new(9, generator(seed, Stream::Views));
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
    fn streams_and_phases_are_independent() {
        let streams = [Stream::Initial, Stream::Views, Stream::Density, Stream::Method];
        let first = |(stream, phase)| phase_generator(3, stream, phase).random::<u64>();
        let cases: Vec<_> = streams.iter().flat_map(|&stream| (0..3).map(move |phase| (stream, phase))).collect();
        let drawn: std::collections::BTreeSet<u64> = cases.iter().map(|&case| first(case)).collect();
        assert_eq!(drawn.len(), cases.len());
        assert_eq!(first((Stream::Views, 0)), generator(3, Stream::Views).random::<u64>());
    }
}

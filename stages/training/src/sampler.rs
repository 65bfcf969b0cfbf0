//! Which training view comes next.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Draws views without replacement, epoch by epoch, in an order that the seed fixes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewSampler {
    count: usize,
    remaining: Vec<usize>,
    random: ChaCha8Rng,
}

impl ViewSampler {
    /// A sampler of `count` views (at least one).
    pub fn new(count: usize, seed: u64) -> Self {
        assert!(count > 0, "a sampler needs views");
        Self { count, remaining: Vec::new(), random: generator(seed, Stream::Views) }
    }

    /// The next view's index.
    pub fn next_view(&mut self) -> usize {
        if self.remaining.is_empty() {
            self.remaining = (0..self.count).collect();
        }
        let at = self.random.random_range(0..self.remaining.len() as u64) as usize;
        self.remaining.swap_remove(at)
    }
}

/// The independent random streams of one training.
#[derive(Clone, Copy, Debug)]
pub enum Stream {
    /// First values of the parameters.
    Initial = 0,
    /// Order of the views.
    Views = 1,
    /// Positions of split Gaussians.
    Density = 2,
    /// Draws of a method within its steps.
    Method = 3,
}

/// The generator of one stream.
pub fn generator(seed: u64, stream: Stream) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(stream as u64);
    random
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_epoch_sees_every_view_once_in_another_order() {
        let mut sampler = ViewSampler::new(17, 3);
        let epochs: Vec<Vec<usize>> = (0..3).map(|_| (0..17).map(|_| sampler.next_view()).collect()).collect();
        for epoch in &epochs {
            let mut sorted = epoch.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..17).collect::<Vec<_>>());
        }
        assert_ne!(epochs[0], epochs[1]);
    }

    #[test]
    fn the_state_survives_serialisation_and_the_seed_decides() {
        let mut sampler = ViewSampler::new(9, 1);
        (0..5).for_each(|_| {
            sampler.next_view();
        });
        let mut copy: ViewSampler = serde_json::from_str(&serde_json::to_string(&sampler).unwrap()).unwrap();
        let draw = |sampler: &mut ViewSampler| (0..30).map(|_| sampler.next_view()).collect::<Vec<_>>();
        assert_eq!(draw(&mut sampler), draw(&mut copy));
        assert_ne!(draw(&mut ViewSampler::new(9, 1)), draw(&mut ViewSampler::new(9, 2)));
    }
}

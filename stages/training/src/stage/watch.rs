//! The environment of a training.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use engine::Progress;
use shaders::tape::Device;

/// The environment of a training: its device, its folder, its stop flag and its progress callback.
pub struct Watch<'a> {
    /// Set to make the training save a checkpoint and stop.
    pub stop: &'a AtomicBool,
    /// The share of the last phase's steps after which the training saves a checkpoint and stops.
    pub pause_at: Option<f64>,
    /// Receives progress.
    pub on_progress: &'a (dyn Fn(Progress) + Send + Sync),
    /// The folder of checkpoints.
    pub checkpoint_dir: &'a Path,
    /// The device that computes the steps.
    pub device: Device,
}

impl Watch<'_> {
    /// Whether a training of (finished, all) steps, `last` of them in its last phase, has reached the point at which it
    /// pauses. Earlier phases do not train all parts of a method, so trainings cannot be compared before the last
    /// phase.
    pub(super) fn is_due(&self, (done, total): (u64, u64), last: u64) -> bool {
        let before = total.saturating_sub(last) as f64;
        self.pause_at.is_some_and(|share| done as f64 >= before + share * last as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_is_a_share_of_the_last_phase() {
        let stop = AtomicBool::new(false);
        let watch = |pause_at| Watch {
            stop: &stop,
            pause_at,
            on_progress: &|_| (),
            checkpoint_dir: Path::new(""),
            device: Device::Cpu,
        };
        let first = |share| (0..=460).find(|done| watch(Some(share)).is_due((*done, 460), 400));
        assert_eq!([1.0 / 9.0, 1.0 / 3.0, 0.5].map(first), [Some(105), Some(194), Some(260)]);
        assert!(!watch(None).is_due((460, 460), 400));
    }
}

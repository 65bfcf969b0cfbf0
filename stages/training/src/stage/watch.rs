//! The environment of a training.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use engine::Progress;
use shaders::tape::Device;

/// The environment of a training: its device, its folder, its stop flag and its progress callback.
pub struct Watch<'a> {
    /// Set to make the training save a checkpoint and stop.
    pub stop: &'a AtomicBool,
    /// The share of the steps after which the training saves a checkpoint and stops.
    pub pause_at: Option<f64>,
    /// Receives progress.
    pub on_progress: &'a (dyn Fn(Progress) + Send + Sync),
    /// The folder of checkpoints.
    pub checkpoint_dir: &'a Path,
    /// The device that computes the steps.
    pub device: Device,
}

impl Watch<'_> {
    /// Whether a training of (finished, all) steps has come to the point at which it pauses.
    pub(super) fn is_due(&self, (done, total): (u64, u64)) -> bool {
        self.pause_at.is_some_and(|share| done as f64 >= share * total as f64)
    }
}

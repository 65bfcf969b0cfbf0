//! The environment of a training.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use engine::Progress;
use shaders::tape::Device;

/// The environment of a training: its device, its folder, its stop flag and its progress callback.
pub struct Watch<'a> {
    /// Set to make the training save a checkpoint and stop.
    pub stop: &'a AtomicBool,
    /// Receives progress.
    pub on_progress: &'a (dyn Fn(Progress) + Send + Sync),
    /// The folder of checkpoints.
    pub checkpoint_dir: &'a Path,
    /// The device that computes the steps.
    pub device: Device,
}

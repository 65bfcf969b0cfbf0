//! One run: a method on a scene with a seed.

use std::collections::{BTreeMap, BTreeSet};

use engine::FailureKind;
use metric_evaluation::{Score, Trivial, TrivialOverlap};
use scene::{Protocol, Split};
use serde::{Deserialize, Serialize};
use training::LargestGradient;

use super::costs::Costs;
use super::degenerate::DegenerateRun;
use super::influence::LossInfluence;
use crate::column::Column;

/// The outcome of runs whose renders show no more than an image that needs no model.
pub const DEGENERATE: &str = "degenerate";

/// The outcome of runs that neither failed nor are degenerate.
pub(crate) const FINISHED: &str = "finished";

/// One method on one scene with one seed, with its measurements or its failure.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// The scene's name.
    pub scene: String,
    /// The table row: the method, and the values of any axis besides scene and seed.
    pub row: String,
    /// The method's id, by which published values are looked up.
    pub method: String,
    /// The value of the axis `ablation`, if the recipe has that axis.
    pub variant: Option<String>,
    /// The values of all axes but scene, method and seed and the one that defines the variant.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub axes: BTreeMap<String, String>,
    /// The value of the axis `seed`.
    pub seed: String,
    /// Origin and format of the images; none if the run failed before it had any.
    pub protocol: Option<Protocol>,
    /// The evaluated images and the metric definitions (see [`metric_evaluation::Metrics::judged_by`]).
    pub judged_by: Option<String>,
    /// Measured values by column; an undefined one carries the reason.
    pub figures: BTreeMap<Column, Score>,
    /// Quality over training time, one point per evaluation.
    pub curve: Vec<CurvePoint>,
    /// The split whose views the curve was measured on.
    pub curve_split: Option<Split>,
    /// Quality of every evaluated image, in the order of the capture.
    pub frames: Vec<FrameScore>,
    /// Seconds of training by activity.
    pub phases: BTreeMap<String, f64>,
    /// Costs by phase, by loss and by skipped work.
    pub costs: Costs,
    /// The influence of every loss but the photometric one.
    #[serde(default)]
    pub influence: Vec<LossInfluence>,
    /// The effects that the training simulated.
    #[serde(default)]
    pub effects: BTreeSet<String>,
    /// Those of them that stay on even if they are inert, each with the reason.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub kept_effects: BTreeMap<String, String>,
    /// The largest gradient of the training.
    #[serde(default)]
    pub largest_gradient: Option<TensorGradient>,
    /// How often the rasteriser clamped a value, by guard.
    #[serde(default)]
    pub guards: BTreeMap<String, u64>,
    /// Scale of the method's own schedule; 1 is the whole schedule.
    pub schedule_scale: Option<f64>,
    /// The budget in seconds to which the schedule was scaled, if any.
    #[serde(default)]
    pub budget_secs: Option<f64>,
    /// Machines of the measurements, by work (`training`, `rendering`, `judging`).
    pub machines: BTreeMap<String, Machine>,
    /// The first failure, if any.
    pub failure: Option<RunFailure>,
    /// IoU of the answer to each prompt.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub prompts: BTreeMap<String, Score>,
    /// IoU of answers to these prompts that need no model.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub trivial_prompts: BTreeMap<String, TrivialOverlap>,
    /// PSNR of images that need no model, against the run's ground truth.
    #[serde(default)]
    pub trivial: Option<Trivial>,
    /// Set if the renders show no more than an image that needs no model. The run's values are then excluded from
    /// means, ranks and comparisons.
    #[serde(default)]
    pub degenerate: Option<DegenerateRun>,
    /// What the training reported about itself, e.g. that density control was stopped.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notices: Vec<String>,
    /// The jobs by port, to trace a number to its job.
    pub jobs: BTreeMap<String, Job>,
}

/// Quality at one evaluation during training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Seconds of training so far, evaluation excluded.
    pub seconds: f64,
    /// Optimiser steps so far.
    pub iteration: u64,
    /// Number of Gaussians at the evaluation.
    #[serde(default)]
    pub n_gaussians: u64,
    /// PSNR in dB on a few views of the run's `curve_split`.
    pub psnr_val: Option<f64>,
}

/// The largest gradient of a training, over all tensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TensorGradient {
    /// The tensor's name.
    pub tensor: String,
    /// Magnitude, phase and iteration of the gradient.
    #[serde(flatten)]
    pub largest: LargestGradient,
}

/// Quality of one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameScore {
    /// The view's name.
    pub name: String,
    /// Capture time of the image, if known.
    pub time_secs: Option<f64>,
    /// PSNR in dB.
    pub psnr: f64,
}

/// One job of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// The job's name, e.g. `train/lego/mcgs/0`.
    pub name: String,
    /// The first digits of the job's action key; empty without one.
    pub key: String,
    /// Wall time in seconds, if known.
    pub wall_secs: Option<f64>,
}

/// The machine that ran a job; unknown properties are absent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Machine {
    /// The compute device, e.g. `cpu`.
    pub device: String,
    /// Number of worker threads of the job.
    pub threads: Option<u64>,
    /// The processor's name.
    pub cpu: Option<String>,
    /// Number of physical cores.
    pub cores: Option<u64>,
    /// Number of hardware threads.
    pub hardware_threads: Option<u64>,
    /// Size of the main memory, bytes.
    pub memory_bytes: Option<f64>,
    /// Operating system, release and architecture.
    pub system: Option<String>,
    /// Name and version of the program.
    pub program: Option<String>,
    /// Digest of the sources that the program was built from.
    pub sources: Option<String>,
    /// The compiler that built the program.
    pub built_with: Option<String>,
}

/// A failure of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunFailure {
    /// The job that failed, e.g. `train/lego/mcgs/0`.
    pub producer: String,
    /// The kind of failure.
    pub kind: FailureKind,
    /// Message and hint, without paths, because paths differ between machines.
    pub message: String,
}

impl Run {
    /// The protocol and the evaluated images; none for a run without values.
    pub fn protocol_lines(&self) -> Option<[String; 2]> {
        Some([self.protocol.as_ref()?.line(), self.judged_by.clone()?])
    }

    /// The outcome in a word: `finished`, `degenerate`, or the kind of failure.
    pub fn outcome(&self) -> &'static str {
        match (&self.failure, &self.degenerate) {
            (Some(failure), _) => failure_mark(failure.kind),
            (None, Some(_)) => DEGENERATE,
            (None, None) => FINISHED,
        }
    }

    /// Whether `other` has the same scene, row and jobs. Such a run is not a replicate and contains no information
    /// about noise.
    pub(super) fn repeats(&self, other: &Self) -> bool {
        let keys = |run: &Self| run.jobs.iter().map(|(port, job)| (port.clone(), job.key.clone())).collect::<Vec<_>>();
        let is_known = !self.jobs.is_empty() && self.jobs.values().all(|job| !job.key.is_empty());
        is_known && (&self.scene, &self.row) == (&other.scene, &other.row) && keys(self) == keys(other)
    }
}

impl Machine {
    /// The machine in one line, e.g. `cpu (Ryzen 7), 2 threads`. Equal lines mean machines of one kind.
    pub fn line(&self) -> String {
        let cpu = self.cpu.as_ref().map(|cpu| format!(" ({cpu})")).unwrap_or_default();
        let threads = self.threads.map(|threads| format!(", {threads} threads")).unwrap_or_default();
        format!("{}{cpu}{threads}", self.device)
    }
}

/// The text that replaces a number in a cell, by kind of failure.
pub(crate) fn failure_mark(kind: FailureKind) -> &'static str {
    match kind {
        FailureKind::MissingData => "no data",
        FailureKind::BadInput => "bad input",
        FailureKind::Diverged => "diverged",
        FailureKind::OutOfMemory => "OOM",
        FailureKind::Timeout => "timeout",
        // Runs make no table of stopped jobs; `table --partial` does, of the jobs that have no result.
        FailureKind::Interrupted => "not run yet",
        FailureKind::DeviceLost => "device lost",
        FailureKind::World => "machine",
        FailureKind::Crashed => "crash",
    }
}

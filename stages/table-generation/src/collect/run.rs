//! What is known of one run.

use std::collections::BTreeMap;

use engine::FailureKind;
use metric_evaluation::Score;
use scene::{Protocol, Split};
use serde::{Deserialize, Serialize};
use training::LargestGradient;

use super::costs::Costs;
use crate::Column;

/// One method on one scene with one seed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// The scene's name.
    pub scene: String,
    /// The table row: the method, and the values of any axis besides scene and seed.
    pub row: String,
    /// The method's id, which published values are found by.
    pub method: String,
    /// The value of the axis [`super::VARIANTS`], where the recipe has it.
    pub variant: Option<String>,
    /// The seed's axis value.
    pub seed: String,
    /// How the images came to be, as far as the run came to have any.
    pub protocol: Option<Protocol>,
    /// Who judged what (see [`metric_evaluation::Metrics::judged_by`]).
    pub judged_by: Option<String>,
    /// The figures; an undefined one says why.
    pub figures: BTreeMap<Column, Score>,
    /// Quality over training time.
    pub curve: Vec<CurvePoint>,
    /// The split whose views the curve was measured on.
    pub curve_split: Option<Split>,
    /// Quality of every judged image, in the order of the capture.
    pub frames: Vec<FrameScore>,
    /// Seconds per phase of training.
    pub phases: BTreeMap<String, f64>,
    /// The same by phase, loss and what was left out.
    pub costs: Costs,
    /// The largest gradient of the training.
    #[serde(default)]
    pub largest_gradient: Option<TensorGradient>,
    /// How often the rasteriser kept a number in range, by what was out of it.
    #[serde(default)]
    pub guards: BTreeMap<String, u64>,
    /// The factor that the method's own schedule was stretched by; 1 is the whole schedule.
    pub schedule_scale: Option<f64>,
    /// The seconds that the training was cut to, if it was.
    #[serde(default)]
    pub budget_secs: Option<f64>,
    /// What was measured on which machine, by work (`training`, `rendering`).
    pub machines: BTreeMap<String, Machine>,
    /// What went wrong first, if anything did.
    pub failure: Option<RunFailure>,
    /// The jobs by port, for tracing a number to its job.
    pub jobs: BTreeMap<String, Job>,
}

/// Quality at one moment of training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Seconds of training, evaluation excluded.
    pub seconds: f64,
    /// Optimiser steps so far.
    pub iteration: u64,
    /// Gaussians at that moment.
    #[serde(default)]
    pub n_gaussians: u64,
    /// PSNR in dB on a few views of the run's `curve_split`.
    pub psnr_val: Option<f64>,
}

/// The largest gradient that any tensor had during a training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TensorGradient {
    /// The tensor.
    pub tensor: String,
    /// How large, and when.
    #[serde(flatten)]
    pub largest: LargestGradient,
}

/// Quality of one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameScore {
    /// The view's name.
    pub name: String,
    /// When the image was taken, where that is known.
    pub time_secs: Option<f64>,
    /// PSNR in dB.
    pub psnr: f64,
}

/// One job of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// The job's name, as `train/lego/mcgs/0`.
    pub name: String,
    /// The first digits of its action key; empty where it has none.
    pub key: String,
    /// How long it took, where that is known.
    pub wall_secs: Option<f64>,
}

/// What a job ran on; what is not known is absent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Machine {
    /// The device that computed, as `cpu`.
    pub device: String,
    /// Worker threads that the job had.
    pub threads: Option<u64>,
    /// The processor.
    pub cpu: Option<String>,
    /// Its physical cores.
    pub cores: Option<u64>,
    /// Its threads.
    pub hardware_threads: Option<u64>,
    /// Main memory, bytes.
    pub memory_bytes: Option<f64>,
    /// System, release and architecture.
    pub system: Option<String>,
    /// Name and version of the program.
    pub program: Option<String>,
    /// Digest of the sources that the program was built from.
    pub sources: Option<String>,
    /// The compiler that built it.
    pub built_with: Option<String>,
}

/// Why a run has no numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunFailure {
    /// The job that failed, as `train/lego/mcgs/0`.
    pub producer: String,
    /// The kind of thing that went wrong.
    pub kind: FailureKind,
    /// What went wrong, and what to do about it; without paths, which differ between machines.
    pub message: String,
}

impl Run {
    /// Whether `other` has its numbers from the same jobs, so that they say nothing about noise.
    pub(super) fn repeats(&self, other: &Self) -> bool {
        let keys = |run: &Self| run.jobs.iter().map(|(port, job)| (port.clone(), job.key.clone())).collect::<Vec<_>>();
        let is_known = !self.jobs.is_empty() && self.jobs.values().all(|job| !job.key.is_empty());
        is_known && (&self.scene, &self.row) == (&other.scene, &other.row) && keys(self) == keys(other)
    }
}

impl Machine {
    /// `cpu (Ryzen 7), 2 threads`: times with equal lines were measured on machines of one kind.
    pub fn line(&self) -> String {
        let cpu = self.cpu.as_ref().map(|cpu| format!(" ({cpu})")).unwrap_or_default();
        let threads = self.threads.map(|threads| format!(", {threads} threads")).unwrap_or_default();
        format!("{}{cpu}{threads}", self.device)
    }
}

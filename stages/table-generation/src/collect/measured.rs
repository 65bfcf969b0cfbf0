//! The measurements that stages record alongside their artifacts.

use std::collections::BTreeMap;

use anyhow::Context as _;
use engine::InputRecord;
use scene::Split;
use serde::Deserialize;
use training::{LargestGradient, PhaseInfluence};

use super::costs::Costs;
use super::run::{CurvePoint, Machine, TensorGradient};

/// Measurements of a training.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(crate) struct TrainingMeasurements {
    pub training_secs: Option<f64>,
    pub ms_per_iteration: Option<f64>,
    pub peak_memory_bytes: Option<f64>,
    pub curve: Vec<CurvePoint>,
    pub curve_split: Option<Split>,
    pub phases: BTreeMap<String, f64>,
    pub largest_gradients: BTreeMap<String, LargestGradient>,
    pub guards: BTreeMap<String, u64>,
    pub notices: Vec<String>,
    pub influence: BTreeMap<String, PhaseInfluence>,
    pub kept_effects: BTreeMap<String, String>,
    #[serde(flatten)]
    pub costs: Costs,
}

impl TrainingMeasurements {
    /// The largest gradient of all tensors.
    pub(crate) fn largest_gradient(&self) -> Option<TensorGradient> {
        let all = self.largest_gradients.iter();
        let (tensor, largest) = all.max_by(|(_, a), (_, b)| a.magnitude.total_cmp(&b.magnitude))?;
        Some(TensorGradient { tensor: tensor.clone(), largest: largest.clone() })
    }
}

/// Measurements of a rendering.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(crate) struct RenderingMeasurements {
    pub fps_raster: Option<FrameRate>,
    pub fps_model: Option<FrameRate>,
    pub fps_delivered: Option<FrameRate>,
}

/// Frames per second over the rendered views.
#[derive(Deserialize)]
pub(crate) struct FrameRate {
    pub median: f64,
}

/// Measurements of every job.
#[derive(Default, Deserialize)]
#[serde(default)]
struct JobMeasurements {
    job: Wall,
    machine: Machine,
    device: Option<String>,
    threads: Option<u64>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Wall {
    wall_secs: Option<f64>,
}

/// The producer's measurements; defaults if it recorded none.
pub(crate) fn measurements<T: Default + for<'a> Deserialize<'a>>(record: &InputRecord) -> anyhow::Result<T> {
    if record.measurements.is_null() {
        return Ok(T::default());
    }
    T::deserialize(&record.measurements).with_context(|| format!("cannot read the measurements of {}", record.producer))
}

/// Wall time in seconds and machine of the producer, where recorded.
pub(crate) fn time_and_machine(record: &InputRecord) -> anyhow::Result<(Option<f64>, Option<Machine>)> {
    let JobMeasurements { job, machine, device, threads } = measurements(record)?;
    Ok((job.wall_secs, device.map(|device| Machine { device, threads, ..machine })))
}

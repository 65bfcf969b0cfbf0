//! The interface of a running job to the engine.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use serde::Serialize;
use serde_json::Value;

use crate::{Artifact, Failure, FailureKind};

/// The axis values of a node, e.g. `{"scene": "lego", "seed": "0"}`.
pub type Coordinates = BTreeMap<String, String>;

/// One producer on an input port, with its artifact or its failure.
#[derive(Clone, Debug)]
pub struct InputRecord {
    /// The producer's node name, e.g. `train/lego/mcgs/0`.
    pub producer: String,
    /// The producer's axis values.
    pub coordinates: Coordinates,
    /// The artifact's folder, or the failure of its producer.
    pub artifact: Result<PathBuf, Failure>,
    /// The producer's measurements; null unless the port reads or relays them.
    pub measurements: Value,
    /// The producer's action key, with which a table cell can be traced.
    pub action_key: String,
}

/// An input with its opened artifact.
pub struct Input<A> {
    /// The producer.
    pub record: InputRecord,
    /// The artifact, or the failure of its producer.
    pub artifact: Result<A, Failure>,
}

/// The progress of a job, for displays.
#[derive(Clone, Debug, Default, PartialEq, Serialize, serde::Deserialize)]
pub struct Progress {
    /// Number of steps done.
    pub done: u64,
    /// Total number of steps.
    pub total: u64,
    /// A short status, e.g. `27.4 dB`.
    pub message: String,
}

/// The environment of one job: its inputs, its folders, and the sinks for progress and measurements.
pub struct JobContext {
    /// The node's name, e.g. `train/lego/mcgs/0`.
    pub(crate) name: String,
    /// Number of worker threads that the job may use. Results must not depend on it.
    pub threads: usize,
    /// The device for stages that compute on one: `"cpu"`, or the name of a GPU of this machine.
    pub device: String,
    /// Whether to profile the job, which slows it down.
    pub profile: bool,
    /// The share of the work, in [0, 1] and in the stage's own units, after which the job saves a checkpoint and stops
    /// as on a stop request. The result of a job that continues from the checkpoint must not depend on it.
    pub pause_at: Option<f64>,
    /// The producers on each port.
    pub inputs: BTreeMap<String, Vec<InputRecord>>,
    /// The absolute path of each declared source.
    pub sources: BTreeMap<String, PathBuf>,
    /// The empty folder that becomes the artifact.
    pub(crate) output_dir: PathBuf,
    /// A folder that is kept when a run of this action key is interrupted.
    pub(crate) checkpoint_dir: PathBuf,
    /// Set when the job is to save a checkpoint and stop.
    pub stop: Arc<AtomicBool>,
    /// Receives progress.
    pub on_progress: Box<dyn Fn(Progress) + Send + Sync>,
    /// The measurements recorded so far.
    pub measurements: RefCell<serde_json::Map<String, Value>>,
    /// The longest time of saving a checkpoint, seconds; none if none was saved.
    pub(crate) checkpoint_secs: Cell<Option<f64>>,
}

impl JobContext {
    /// A context outside of any run, e.g. for tests. Creates `root/output` and `root/checkpoint`.
    pub fn detached(root: &Path) -> std::io::Result<Self> {
        let (output_dir, checkpoint_dir) = (root.join("output"), root.join("checkpoint"));
        std::fs::create_dir_all(&output_dir)?;
        std::fs::create_dir_all(&checkpoint_dir)?;
        Ok(Self {
            name: "detached".into(),
            threads: 1,
            device: "cpu".into(),
            profile: false,
            pause_at: None,
            inputs: BTreeMap::new(),
            sources: BTreeMap::new(),
            output_dir,
            checkpoint_dir,
            stop: Arc::default(),
            on_progress: Box::new(|_| ()),
            measurements: RefCell::default(),
            checkpoint_secs: Cell::default(),
        })
    }

    /// The folder into which the stage writes the artifact.
    pub fn output_dir(&self) -> &Path {
        &self.output_dir
    }

    /// The folder for the checkpoints of this action key, which outlives an interrupted run.
    pub fn checkpoint_dir(&self) -> &Path {
        &self.checkpoint_dir
    }

    /// Opens and checks the one artifact on `port`.
    pub fn input<A: Artifact>(&self, port: &str) -> anyhow::Result<A> {
        let [record] = self.records(port)? else {
            anyhow::bail!("port {port} of {} needs exactly one producer", self.name);
        };
        open_checked(record.artifact.as_ref().map_err(Clone::clone)?, &record.producer)
    }

    /// Opens and checks the artifact on an optional port; `None` if the port has no producer.
    pub fn optional_input<A: Artifact>(&self, port: &str) -> anyhow::Result<Option<A>> {
        if self.records(port)?.is_empty() { Ok(None) } else { self.input(port).map(Some) }
    }

    /// The first producer on `port` without opening its artifact, e.g. for its measurements.
    pub fn input_record(&self, port: &str) -> anyhow::Result<&InputRecord> {
        self.records(port)?.first().with_context(|| format!("port {port} of {} has no producer", self.name))
    }

    /// Opens and checks every artifact on `port`. Failed producers are passed on as failures.
    pub fn inputs<A: Artifact>(&self, port: &str) -> anyhow::Result<Vec<Input<A>>> {
        let open = |record: &InputRecord| {
            let artifact = match &record.artifact {
                Ok(dir) => Ok(open_checked(dir, &record.producer)?),
                Err(failure) => Err(failure.clone()),
            };
            Ok(Input { record: record.clone(), artifact })
        };
        self.records(port)?.iter().map(open).collect()
    }

    /// The absolute path of a declared source.
    pub fn source(&self, name: &str) -> anyhow::Result<&Path> {
        let path = self.sources.get(name).with_context(|| format!("{} declares no source {name}", self.name))?;
        Ok(path)
    }

    /// Whether the job is to save a checkpoint and return [`JobContext::interrupted`].
    pub fn should_stop(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The error of a job that stopped on request after saving its progress.
    pub fn interrupted(&self) -> anyhow::Error {
        Failure::new(FailureKind::Interrupted, "stopped on request").into()
    }

    /// Reports the job's progress.
    pub fn progress(&self, done: u64, total: u64, message: impl Into<String>) {
        (self.on_progress)(Progress { done, total, message: message.into() });
    }

    /// Records a measurement (seconds, memory, rates). The artifact's bytes must not depend on it.
    pub fn measure(&self, name: &str, value: impl Serialize) -> anyhow::Result<()> {
        self.measurements.borrow_mut().insert(name.into(), serde_json::to_value(value)?);
        Ok(())
    }

    /// Records the longest time that saving a checkpoint took, in seconds. Batch jobs are warned of their end early enough
    /// for it.
    pub fn measure_checkpoint(&self, longest_secs: f64) {
        self.checkpoint_secs.set(Some(longest_secs));
    }

    fn records(&self, port: &str) -> anyhow::Result<&[InputRecord]> {
        let records = self.inputs.get(port).with_context(|| format!("{} has no port {port}", self.name))?;
        Ok(records)
    }
}

/// Opens and checks the artifact in `dir`; errors name its producer.
fn open_checked<A: Artifact>(dir: &Path, producer: &str) -> anyhow::Result<A> {
    let artifact = A::open(dir).with_context(|| format!("cannot read the {} of {producer}", A::NAME))?;
    artifact.check().with_context(|| format!("the {} of {producer} is not valid", A::NAME))?;
    Ok(artifact)
}

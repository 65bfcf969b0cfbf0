//! What a running job may see and do.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use serde::Serialize;
use serde_json::Value;

use crate::{Artifact, Failure, FailureKind};

/// The axis values of a node, as `{"scene": "lego", "seed": "0"}`.
pub type Coordinates = BTreeMap<String, String>;

/// One producer on an input port: where its artifact lies, or why there is none.
#[derive(Clone, Debug)]
pub struct InputRecord {
    /// The producer's node name, as `train/lego/mcgs/0`.
    pub producer: String,
    /// The producer's axis values.
    pub coordinates: Coordinates,
    /// The artifact's folder, or the failure of its producer.
    pub artifact: Result<PathBuf, Failure>,
    /// The producer's measurements (null unless the port reads or relays them).
    pub measurements: Value,
    /// The producer's action key, so that a table cell can be traced.
    pub action_key: String,
}

/// An opened input.
pub struct Input<A> {
    /// Where it comes from.
    pub record: InputRecord,
    /// The artifact, or why there is none.
    pub artifact: Result<A, Failure>,
}

/// How far a job has come; shown by whoever watches it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, serde::Deserialize)]
pub struct Progress {
    /// Steps done.
    pub done: u64,
    /// Steps in all.
    pub total: u64,
    /// A short figure, as `27.4 dB`.
    pub message: String,
}

/// The world as one job sees it: its inputs, its folders, and whom to tell how far it is.
pub struct JobContext {
    /// The node's name, as `train/lego/mcgs/0`.
    pub name: String,
    /// The node's axis values.
    pub coordinates: Coordinates,
    /// The job's own action key.
    pub action_key: String,
    /// Worker threads that this job may use; results must not depend on it.
    pub threads: usize,
    /// What to compute on, for stages that do so on a device: `"cpu"`, or what names one GPU of this machine.
    pub device: String,
    /// Whether to measure closely what time goes into, at some cost in time.
    pub profile: bool,
    /// Producers by port name.
    pub inputs: BTreeMap<String, Vec<InputRecord>>,
    /// Absolute source paths by name.
    pub sources: BTreeMap<String, PathBuf>,
    /// The empty folder that becomes the artifact.
    pub output_dir: PathBuf,
    /// A folder that outlives an interrupted run of this very action key.
    pub checkpoint_dir: PathBuf,
    /// Set when the job should save a checkpoint and stop.
    pub stop: Arc<AtomicBool>,
    /// Receives progress.
    pub on_progress: Box<dyn Fn(Progress) + Send + Sync>,
    /// Side results that must not influence the artifact's bytes: seconds, memory, rates.
    pub measurements: RefCell<serde_json::Map<String, Value>>,
}

impl JobContext {
    /// A context outside any run, for tests: `root/output` and `root/checkpoint` are created.
    pub fn detached(root: &Path) -> std::io::Result<Self> {
        let (output_dir, checkpoint_dir) = (root.join("output"), root.join("checkpoint"));
        std::fs::create_dir_all(&output_dir)?;
        std::fs::create_dir_all(&checkpoint_dir)?;
        Ok(Self {
            name: "detached".into(),
            coordinates: Coordinates::new(),
            action_key: "detached".into(),
            threads: 1,
            device: "cpu".into(),
            profile: false,
            inputs: BTreeMap::new(),
            sources: BTreeMap::new(),
            output_dir,
            checkpoint_dir,
            stop: Arc::default(),
            on_progress: Box::new(|_| ()),
            measurements: RefCell::default(),
        })
    }

    /// The folder to write the artifact into.
    pub fn output_dir(&self) -> &Path {
        &self.output_dir
    }

    /// The folder for checkpoints of this action key.
    pub fn checkpoint_dir(&self) -> &Path {
        &self.checkpoint_dir
    }

    /// Opens and checks the one artifact on `port`.
    pub fn input<A: Artifact>(&self, port: &str) -> anyhow::Result<A> {
        let [record] = self.records(port)? else {
            anyhow::bail!("port {port} of {} has not exactly one producer", self.name);
        };
        open_checked(record.artifact.as_ref().map_err(Clone::clone)?, &record.producer)
    }

    /// Opens and checks the artifact on a port that may have none.
    pub fn optional_input<A: Artifact>(&self, port: &str) -> anyhow::Result<Option<A>> {
        if self.records(port)?.is_empty() { Ok(None) } else { self.input(port).map(Some) }
    }

    /// The one producer on `port`, unopened: for its coordinates, measurements and action key.
    pub fn input_record(&self, port: &str) -> anyhow::Result<&InputRecord> {
        self.records(port)?.first().with_context(|| format!("port {port} of {} has no producer", self.name))
    }

    /// Opens and checks every artifact on `port`; producers that failed are passed on as failures.
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

    /// Whether the job was asked to save a checkpoint and stop (answer with [`JobContext::interrupted`]).
    pub fn should_stop(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The error that tells the engine: stopped on request, progress is saved.
    pub fn interrupted(&self) -> anyhow::Error {
        Failure::new(FailureKind::Interrupted, "stopped on request").into()
    }

    /// Tells whoever watches how far the job is.
    pub fn progress(&self, done: u64, total: u64, message: impl Into<String>) {
        (self.on_progress)(Progress { done, total, message: message.into() });
    }

    /// Records a side result (seconds, memory, rates) that must not influence the artifact's bytes.
    pub fn measure(&self, name: &str, value: impl Serialize) -> anyhow::Result<()> {
        self.measurements.borrow_mut().insert(name.into(), serde_json::to_value(value)?);
        Ok(())
    }

    fn records(&self, port: &str) -> anyhow::Result<&[InputRecord]> {
        let records = self.inputs.get(port).with_context(|| format!("{} has no port {port}", self.name))?;
        Ok(records)
    }
}

/// Opens the artifact in `dir` and checks it, blaming its producer.
fn open_checked<A: Artifact>(dir: &Path, producer: &str) -> anyhow::Result<A> {
    let artifact = A::open(dir).with_context(|| format!("cannot read the {} of {producer}", A::NAME))?;
    artifact.check().with_context(|| format!("the {} of {producer} is not valid", A::NAME))?;
    Ok(artifact)
}

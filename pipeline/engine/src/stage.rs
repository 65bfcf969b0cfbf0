//! The interface between a stage's crate and the engine.

use std::path::PathBuf;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::{Artifact, Facts, JobContext, PlanContext, Resolution, UnusedSources, Work};

/// A stage: a (nearly) pure function from parameters, input artifacts and source folders to one artifact.
pub trait Stage: 'static {
    /// The typed parameters. Use `#[serde(default, deny_unknown_fields)]`; `Default` holds the default values.
    type Params: Serialize + DeserializeOwned + Default + Send + 'static;
    /// The artifact type that the stage makes.
    type Output: Artifact;

    /// The stable id that recipes use, e.g. `"training"`; part of every key.
    const ID: &'static str;
    /// A one-line description for `--help` and the documentation.
    const ABOUT: &'static str;

    /// Whether jobs compute on the device that the user chooses ([`JobContext::device`](crate::JobContext::device)). If
    /// so, the device's class is part of their keys.
    const ON_DEVICE: bool = false;

    /// The inputs of the stage.
    fn ports() -> Vec<Port>;

    /// The files and folders outside the store that a job reads, relative to the data root.
    fn sources(_params: &Self::Params) -> Vec<Source> {
        Vec::new()
    }

    /// Problems with the parameters that serde cannot detect. Planning reports all of them at once.
    fn check_params(_params: &Self::Params) -> Vec<ParamProblem> {
        Vec::new()
    }

    /// The static facts of the artifact: what is certain about it before anything runs. They may depend only on the
    /// parameters, the facts of the inputs and files below the data root. By default there are none.
    fn facts(_params: &Self::Params, _context: &PlanContext<'_>) -> Facts {
        Facts::default()
    }

    /// Resolves the parameters with the facts of the inputs: every open choice is made, and optional ports that the job
    /// does not read are named. Producers that nothing reads any more are pruned from the plan. Must be idempotent. By
    /// default nothing changes.
    fn resolve(
        params: Self::Params,
        _context: &PlanContext<'_>,
    ) -> Result<Resolution<Self::Params>, Vec<ParamProblem>> {
        Ok(Resolution::unchanged(params))
    }

    /// The expected work of a job with resolved parameters, from which its time is predicted; `None` if it is unknown.
    /// `context` has the facts of the inputs that the job reads. By default, the work grows with the number of inputs.
    /// Never part of a key.
    fn work(_params: &Self::Params, context: &PlanContext<'_>) -> Option<Work> {
        Work::of_inputs(context)
    }

    /// The machine resources that a job uses. Never part of a key.
    fn resources(_params: &Self::Params) -> Resources {
        Resources::default()
    }

    /// Sources of workspace crates that a job with these parameters provably does not use: an edit there does not rerun
    /// it. The same must hold for stages that read its artifact on a port for one and run code of this crate on it.
    fn unused_sources(_params: &Self::Params) -> UnusedSources {
        UnusedSources::new()
    }

    /// All values that the parameter `key` (dotted) can have, in the order of tables, if the stage can list them. A
    /// recipe's axis may then be `"all"`.
    fn values(_key: &str) -> Option<Vec<String>> {
        None
    }

    /// Runs the job: writes into [`JobContext::output_dir`] and returns the artifact.
    fn run(context: &JobContext, params: &Self::Params) -> anyhow::Result<Self::Output>;
}

/// A named input of a stage.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Port {
    /// The port's name in recipes and for [`JobContext::input`].
    pub name: &'static str,
    /// [`Artifact::NAME`] and [`Artifact::SCHEMA`] of the artifact that the port reads.
    pub artifact: (&'static str, u32),
    /// The number of producers that the port takes.
    pub arity: Arity,
    /// The use of the producers' measurements (times, memory).
    pub measurements: Measurements,
}

impl Port {
    /// A port that reads exactly one artifact `A`, without its measurements.
    pub fn one<A: Artifact>(name: &'static str) -> Self {
        Self { name, artifact: (A::NAME, A::SCHEMA), arity: Arity::One, measurements: Measurements::Unread }
    }

    /// A port that reads one artifact `A` if the recipe wires it to a producer, otherwise none.
    pub fn optional<A: Artifact>(name: &'static str) -> Self {
        Self { arity: Arity::Optional, ..Self::one::<A>(name) }
    }

    /// A port for which [`Stage::resolve`] chooses at most one artifact `A` among those that the recipe wires to it.
    pub fn choice<A: Artifact>(name: &'static str) -> Self {
        Self { arity: Arity::Choice, ..Self::one::<A>(name) }
    }

    /// A port that reads any number of artifacts `A`. Failed producers appear as failures.
    pub fn many<A: Artifact>(name: &'static str) -> Self {
        Self { name, artifact: (A::NAME, A::SCHEMA), arity: Arity::Many, measurements: Measurements::Unread }
    }

    /// Makes the port read the producers' measurements, too.
    pub fn with_measurements(mut self) -> Self {
        self.measurements = Measurements::Read;
        self
    }

    /// Makes the port relay the producers' measurements.
    pub fn relaying_measurements(mut self) -> Self {
        self.measurements = Measurements::Relayed;
        self
    }
}

/// The use that a stage makes of the measurements (times, memory) of the producers on a port.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measurements {
    /// The stage does not see them.
    #[default]
    Unread,
    /// The stage adds them to its own measurements only, e.g. the seconds of the model that a training continues. No
    /// artifact depends on them, so they are not part of the key.
    Relayed,
    /// The artifact depends on them, e.g. a table of seconds, so they are part of the key.
    Read,
}

/// The number of producers that a port takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Arity {
    /// Exactly one. The job is skipped if the producer failed.
    One,
    /// One or none, as the recipe wires it. The job is skipped if the producer failed.
    Optional,
    /// At most one of any number that the recipe wires, chosen while planning. Otherwise like [`Arity::Optional`].
    Choice,
    /// All jobs of the wired nodes. The job runs even if some failed; they appear as failures.
    Many,
}

/// A file or folder outside the store; digested before the job runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Source {
    /// The source's name for [`JobContext::source`].
    pub name: &'static str,
    /// The path relative to `--data-root`.
    pub path: PathBuf,
    /// Whether the job also runs without it: a missing path is then no source of the job and no part of its key. Otherwise
    /// the job's outcome is missing data.
    pub optional: bool,
}

impl Source {
    /// A source that a job cannot run without.
    pub fn required(name: &'static str, path: PathBuf) -> Self {
        Self { name, path, optional: false }
    }
}

/// A problem with one parameter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParamProblem {
    /// The dotted key below the node's `params`.
    pub key: String,
    /// The problem, in lower case, without a full stop.
    pub message: String,
    /// Advice, if there is any.
    pub hint: Option<String>,
}

/// The machine resources that one job uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resources {
    /// Number of worker threads; 0 means all of the machine's.
    pub threads: usize,
}

impl Default for Resources {
    fn default() -> Self {
        Self { threads: 1 }
    }
}

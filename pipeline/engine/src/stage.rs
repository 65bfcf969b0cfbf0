//! What a stage crate tells the engine about itself.

use std::path::PathBuf;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{Artifact, JobContext};

/// A stage: a (nearly) pure function from parameters, input artifacts and source folders to one artifact.
pub trait Stage: 'static {
    /// Typed parameters. Use `#[serde(default, deny_unknown_fields)]`; the defaults live in `Default`.
    type Params: Serialize + DeserializeOwned + Default + Send + 'static;
    /// The one artifact type that this stage makes.
    type Output: Artifact;

    /// The stable id that recipes name (`"training"`), part of every key.
    const ID: &'static str;
    /// One line for `--help` and the docs.
    const ABOUT: &'static str;

    /// The artifacts that this stage reads.
    fn ports() -> Vec<Port>;

    /// Folders or files outside the store that this stage reads, relative to the data root.
    fn sources(_params: &Self::Params) -> Vec<Source> {
        Vec::new()
    }

    /// Problems with the parameters that serde cannot see; reported while planning, all at once.
    fn check_params(_params: &Self::Params) -> Vec<ParamProblem> {
        Vec::new()
    }

    /// What a job needs of the machine. Never part of a key.
    fn resources(_params: &Self::Params) -> Resources {
        Resources::default()
    }

    /// Source folders of the stage's own crate (relative to the crate, as `src/methods/mcgs`) that these
    /// parameters provably do not use, so that an edit there does not rerun the job. This holds for readers too: a stage
    /// that runs code of this crate on the one artifact that it reads must not need them either.
    fn unused_sources(_params: &Self::Params) -> Vec<String> {
        Vec::new()
    }

    /// Does the work: writes into `context.output_dir()` and returns the artifact.
    fn run(context: &JobContext, params: &Self::Params) -> anyhow::Result<Self::Output>;
}

/// One named input of a stage.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Port {
    /// The name that recipes wire and that [`JobContext::input`] takes.
    pub name: &'static str,
    /// [`Artifact::NAME`] and [`Artifact::SCHEMA`] of what is read.
    pub artifact: (&'static str, u32),
    /// One artifact, or all instances over the axes that this node does not have.
    pub arity: Arity,
    /// Whether this stage also reads the producer's measurements (times, memory): then they are part of its key.
    pub measurements: bool,
}

impl Port {
    /// A port that reads exactly one artifact `A` and not its measurements.
    pub fn one<A: Artifact>(name: &'static str) -> Self {
        Self { name, artifact: (A::NAME, A::SCHEMA), arity: Arity::One, measurements: false }
    }

    /// A port that reads one artifact `A` where the recipe wires it to a producer, and none where it does not.
    pub fn optional<A: Artifact>(name: &'static str) -> Self {
        Self { arity: Arity::Optional, ..Self::one::<A>(name) }
    }

    /// A port that reads any number of artifacts `A`; failed producers are handed over as outcomes.
    pub fn many<A: Artifact>(name: &'static str) -> Self {
        Self { name, artifact: (A::NAME, A::SCHEMA), arity: Arity::Many, measurements: false }
    }

    /// The same port, reading the measurements too.
    pub fn with_measurements(mut self) -> Self {
        self.measurements = true;
        self
    }
}

/// How many producers a port has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Arity {
    /// Exactly one; the job is skipped if it failed.
    One,
    /// One or none, as the recipe says; the job is skipped if there is one and it failed.
    Optional,
    /// All instances of the producer; failed ones appear as outcomes, and the job runs.
    Many,
}

/// A file or folder outside the store, digested before the job runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Source {
    /// The name that [`JobContext::source`] takes.
    pub name: &'static str,
    /// Where it lies, relative to `--data-root`.
    pub path: PathBuf,
}

/// A problem with one parameter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParamProblem {
    /// Dotted key below the node's `params`.
    pub key: String,
    /// What is wrong, lower case, without a full stop.
    pub message: String,
    /// What to do about it.
    pub hint: Option<String>,
}

/// What one job needs of the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resources {
    /// Worker threads; 0 means all that the machine has.
    pub threads: usize,
}

impl Default for Resources {
    fn default() -> Self {
        Self { threads: 1 }
    }
}

//! What a stage crate tells the engine about itself.

use std::path::PathBuf;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::{Artifact, Facts, JobContext, PlanContext, Resolution};

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

    /// Whether jobs compute on the device that the user chose ([`JobContext::device`](crate::JobContext::device)); its
    /// class is then part of their keys.
    const ON_DEVICE: bool = false;

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

    /// What will be known of the artifact before anything runs; by default nothing. Must depend on the parameters, on
    /// what is known of the inputs and on files below the data root alone; what is not certain is left out.
    fn facts(_params: &Self::Params, _context: &PlanContext<'_>) -> Facts {
        Facts::default()
    }

    /// Parameters that leave nothing open, given what is known of the inputs, and the optional ports that they do not
    /// read; by default everything stays as it is. Jobs and readers that this makes superfluous leave the plan.
    /// Resolving resolved parameters again must change nothing.
    fn resolve(
        params: Self::Params,
        _context: &PlanContext<'_>,
    ) -> Result<Resolution<Self::Params>, Vec<ParamProblem>> {
        Ok(Resolution::unchanged(params))
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
    /// How many producers it may have.
    pub arity: Arity,
    /// What this stage does with the producers' measurements (times, memory).
    pub measurements: Measurements,
}

impl Port {
    /// A port that reads exactly one artifact `A` and not its measurements.
    pub fn one<A: Artifact>(name: &'static str) -> Self {
        Self { name, artifact: (A::NAME, A::SCHEMA), arity: Arity::One, measurements: Measurements::Unread }
    }

    /// A port that reads one artifact `A` where the recipe wires it to a producer, and none where it does not.
    pub fn optional<A: Artifact>(name: &'static str) -> Self {
        Self { arity: Arity::Optional, ..Self::one::<A>(name) }
    }

    /// A port that reads one artifact `A` of those that the recipe wires to it, or none, as [`Stage::resolve`] chooses.
    pub fn choice<A: Artifact>(name: &'static str) -> Self {
        Self { arity: Arity::Choice, ..Self::one::<A>(name) }
    }

    /// A port that reads any number of artifacts `A`; failed producers are handed over as outcomes.
    pub fn many<A: Artifact>(name: &'static str) -> Self {
        Self { name, artifact: (A::NAME, A::SCHEMA), arity: Arity::Many, measurements: Measurements::Unread }
    }

    /// The same port, reading the measurements too.
    pub fn with_measurements(mut self) -> Self {
        self.measurements = Measurements::Read;
        self
    }

    /// The same port, passing the measurements on.
    pub fn relaying_measurements(mut self) -> Self {
        self.measurements = Measurements::Relayed;
        self
    }
}

/// What a stage does with the measurements (times, memory) of the producers on a port.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measurements {
    /// Nothing: it does not get to see them.
    #[default]
    Unread,
    /// It adds them to its own measurements and to nothing else, as the seconds of a model that a training goes on from:
    /// no artifact depends on them, so that they are no part of the key.
    Relayed,
    /// It makes its artifact of them, as a table of seconds: they are part of its key.
    Read,
}

/// How many producers a port has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Arity {
    /// Exactly one; the job is skipped if it failed.
    One,
    /// One or none, as the recipe says; the job is skipped if there is one and it failed.
    Optional,
    /// At most one of any number that the recipe names, chosen while planning; else as [`Arity::Optional`].
    Choice,
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

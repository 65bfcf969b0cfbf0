#![doc = include_str!("../README.md")]

pub mod digest;
pub mod estimate;
pub mod event;
pub mod exit;
pub mod explain;
pub mod graph;
pub mod history;
pub mod job;
pub mod lock;
pub mod plan;
pub mod recipe;
pub mod runs;
pub mod scheduler;
pub mod status;
pub mod store;

mod artifact;
mod canonical;
mod context;
mod failure;
mod fingerprint;
mod key;
mod library;
mod process;
mod registry;
mod resolution;
mod stage;
mod suggest;
mod text;
mod work;

#[cfg(test)]
extern crate self as engine;
#[cfg(test)]
mod test_stages;

pub use artifact::Artifact;
pub use context::{Coordinates, Input, InputRecord, JobContext, Progress};
pub use digest::Digest;
pub use failure::{Failure, FailureKind};
pub use fingerprint::{Code, CodeTable, CrateCode, UnusedSources};
pub use key::{ActionKey, KeyComponents, KeyInput};
pub use library::{Builtins, builtin_name};
pub use plan::{DeviceClass, IdleAxis, Node, Plan, PlanInput, PlanSource};
pub use process::host_name;
pub use registry::{AnyStage, Registry};
pub use resolution::{Decision, Facts, PlanContext, Resolution};
pub use stage::{Arity, Measurements, ParamProblem, Port, Resources, Source, Stage};
pub use store::Store;
pub use suggest::names_hint;
pub use text::count;
pub use work::Work;

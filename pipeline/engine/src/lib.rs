//! The job graph: recipes become plans, plans become cached jobs. Knows no stage, no scene and no GPU.

mod artifact;
mod context;
mod failure;
mod stage;

pub use artifact::Artifact;
pub use context::{Coordinates, Input, InputRecord, JobContext, Progress};
pub use failure::{Failure, FailureKind};
pub use stage::{Arity, ParamProblem, Port, Resources, Source, Stage};

//! The job graph: recipes become plans, plans become cached jobs. Knows no stage, no scene and no GPU.

pub mod canonical;
pub mod fingerprint;
pub mod key;
pub mod plan;
pub mod recipe;
pub mod registry;

mod artifact;
mod context;
mod failure;
mod stage;

pub use artifact::Artifact;
pub use context::{Coordinates, Input, InputRecord, JobContext, Progress};
pub use failure::{Failure, FailureKind};
pub use fingerprint::{Code, CodeTable, CrateCode};
pub use key::{ActionKey, KeyComponents, KeyInput};
pub use plan::{Node, Plan, PlanInput, PlanSource};
pub use registry::{AnyStage, Registry};
pub use stage::{Arity, ParamProblem, Port, Resources, Source, Stage};

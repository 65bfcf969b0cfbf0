//! Training: a capture becomes a [`Model`], by any of the registered methods.
//!
//! | layer | modules |
//! |---|---|
//! | the job | `stage` (runs a training, fits a budget), `planning` (chooses effects and shared phases, predicts work) |
//! | the loop | `trainer` (steps, speculation, checkpoints, telemetry), `player` (a trained model in use) |
//! | the methods | `sharing` (first phases that several trainings share), `params` (the parameters of one training), `methods` (one folder each), `bases` (what they build on) |
//! | the contract | `method` (what a method is and what a step offers it) |
//! | the foundations | `data` (views and optional inputs), `artifact` (models on disk, the influence of losses), `model` (tensors and their optimizer), `shared` (tables of all methods), `effects`, `schedule`, `check` (checks of tables), `clock`, `device` |
//!
//! Modules depend only on the layers below, without cycles.

mod artifact;
mod bases;
mod check;
mod clock;
mod data;
mod device;
mod effects;
mod method;
mod methods;
mod model;
mod params;
mod planning;
mod player;
#[cfg(test)]
mod scene_tests;
mod schedule;
mod shared;
mod sharing;
#[cfg(test)]
mod short_training_tests;
mod stage;
mod trainer;

pub use artifact::{
    GroupShare, INERT_SHARE, LargestGradient, LossInfluence, Model, ModelHeader, NamedTensor, PhaseInfluence,
    largest_share,
};
pub use data::{BackgroundView, Dataset, FeatureTokens, FlowPrior, NOTHING, Supplements, ViewPriors};
pub use device::compute_on;
pub use params::TrainingParams;
pub use planning::{model_work, resolve_for};
pub use player::{Edit, Player, Positions, SemanticImage, StartedFrame};
pub use stage::{Rung, Trained, Training, Watch, train};
pub use trainer::{Report, Trainer, psnr};

//! Training: a capture becomes a [`Model`], by any of the registered methods.

pub mod artifact;
pub mod bases;
pub mod budget;
pub mod checkpoint;
pub mod clock;
pub mod coarse;
pub mod curve;
pub mod dataset;
pub mod device;
pub mod effects;
mod inputs;
pub mod language;
pub mod method;
pub mod methods;
pub mod optimizer;
pub mod params;
pub mod planning;
pub mod player;
pub mod run;
pub mod sampler;
pub mod schedule;
pub mod screen;
pub mod state;
pub mod step;
pub mod supplements;
#[cfg(test)]
mod test_scene;
#[cfg(test)]
mod test_training;
pub mod trainer;
mod view_constants;

pub use artifact::{LargestGradient, Model, ModelHeader, NamedTensor};
pub use params::TrainingParams;
pub use run::Training;

//! Training: a capture becomes a [`Model`], by any of the registered methods.

pub mod artifact;

pub use artifact::{Model, ModelHeader, NamedTensor};

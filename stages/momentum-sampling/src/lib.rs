#![doc = include_str!("../README.md")]

mod artifact;
mod maps;
mod momentum;
mod params;
mod run;
mod sampling;

#[cfg(test)]
mod tests;

pub use artifact::Particles;
pub use params::{Instants, Params};
pub use run::MomentumSampling;

//! Draws particles where things move: momentum, energy and unprojection of KineticGS (equations 3 to 5).

mod artifact;
mod maps;
mod momentum;
mod params;
mod run;
mod sampling;

#[cfg(test)]
mod tests;

pub use artifact::{CanonicalView, Particles};
pub use params::Params;
pub use run::{MomentumSampling, Sampled, sample};

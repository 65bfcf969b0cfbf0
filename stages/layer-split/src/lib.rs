#![doc = include_str!("../README.md")]

mod artifact;
mod median;
mod params;
mod residual;
mod run;
#[cfg(test)]
mod tests;

pub use artifact::Layers;
pub use params::Params;
pub use run::LayerSplit;

#![doc = include_str!("../README.md")]

mod artifact;
#[cfg(test)]
mod file_tests;
mod from_files;
mod median;
mod offset;
mod params;
mod residual;
mod run;
#[cfg(test)]
mod tests;

pub use artifact::Layers;
pub use params::Params;
pub use run::LayerSplit;

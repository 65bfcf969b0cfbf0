#![doc = include_str!("../README.md")]

mod artifact;
mod files;
mod labels;
mod params;
mod run;
mod tensor_file;

#[cfg(test)]
mod tests;

pub use artifact::{Features, TokenGrid};
pub use params::Params;
pub use run::FeatureImport;

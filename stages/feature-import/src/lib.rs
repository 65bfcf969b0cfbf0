#![doc = include_str!("../README.md")]

mod array_file;
mod artifact;
mod files;
mod labels;
mod layouts;
mod params;
mod run;
mod tensor_file;
mod text;

#[cfg(test)]
mod tests;

pub use artifact::{Features, TokenGrid};
pub use params::Params;
pub use run::FeatureImport;
pub use text::TextEmbeddings;

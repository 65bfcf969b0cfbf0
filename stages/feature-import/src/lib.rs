//! Brings what pictures show in words into the pipeline: visual tokens on a grid per view and text embeddings of prompts
//! in one space, computed elsewhere (CLIP) or exactly from instance labels.

mod artifact;
mod files;
mod labels;
mod params;
mod run;
mod tensor_file;

#[cfg(test)]
mod tests;

pub use artifact::{Features, TokenGrid};
pub use params::{FeatureSource, Params};
pub use run::{FeatureImport, from_files, from_labels};

#![doc = include_str!("../README.md")]

mod artifact;
mod continuation;
mod imported;
mod params;
mod propagate;
mod run;
mod static_view;
#[cfg(test)]
mod tests;
mod video;

pub use artifact::{Background, FilledView};
pub use params::Params;
pub use run::InpaintImport;

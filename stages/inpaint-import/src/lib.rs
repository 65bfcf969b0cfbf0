//! The static part of every view, with what moves painted out.

mod artifact;
mod imported;
pub mod params;
mod propagate;
mod run;
mod still;
#[cfg(test)]
mod tests;

pub use artifact::{Background, BackgroundView, FilledFiles, FilledView};
pub use params::Params;
pub use run::{CaptureArtifact, InpaintImport};

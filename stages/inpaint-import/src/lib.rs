//! The static part of every view, with what moves painted out.

mod artifact;

pub use artifact::{Background, BackgroundView, FilledView};

//! The split of every view into what moves and what does not.

mod artifact;

pub use artifact::{LayerView, Layers};

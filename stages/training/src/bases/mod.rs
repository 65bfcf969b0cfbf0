//! What methods are built from. Bases know the trainer's vocabulary and no method.

pub mod anchors;
pub mod bounds;
pub mod canonical;
pub mod control_nodes;
pub mod coordinate_mlp;
pub mod gates;
pub mod gaussians;
pub mod heads;
pub mod hexplane;
pub mod layers;
pub mod primitives4d;
pub mod space_filling_curves;
pub mod stillness;

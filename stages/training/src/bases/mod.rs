//! What methods are built from. Bases know the trainer's vocabulary and no method.

pub(crate) mod anchors;
pub(crate) mod bounds;
pub(crate) mod canonical;
pub(crate) mod control_nodes;
pub(crate) mod coordinate_mlp;
pub(crate) mod gates;
pub(crate) mod gaussians;
pub(crate) mod heads;
pub(crate) mod hexplane;
pub(crate) mod layers;
pub(crate) mod primitives4d;
pub(crate) mod space_filling_curves;
pub(crate) mod static_mask;

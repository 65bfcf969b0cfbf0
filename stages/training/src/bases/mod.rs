//! The building blocks of methods. A base uses the contract of [`crate::method`] and depends on no method.

pub(crate) mod anchors;
pub(crate) mod bounds;
pub(crate) mod canonical;
pub(crate) mod collapse;
pub(crate) mod control_nodes;
pub(crate) mod coordinate_mlp;
pub(crate) mod gates;
pub(crate) mod gaussians;
pub(crate) mod heads;
pub(crate) mod hexplane;
pub(crate) mod layers;
pub(crate) mod primitives4d;
pub(crate) mod random_background;
pub(crate) mod seeds;
pub(crate) mod space_filling_curves;
pub(crate) mod static_mask;
pub(crate) mod time_noise;

//! The differentiable kernels: a tape of coarse operations ([`tape`]) and one folder per kernel with its equations, its
//! readable reference, its fast body and its tests.

pub mod check;
pub mod hexplane;
pub mod linear;
pub mod pointwise;
pub mod tape;

//! Tests over small generated captures, and over real ones where `PIPELINE_DATA` names them.

mod blender;
mod blender_lens;
mod colmap;
mod fuzz;
mod inspect;
mod lens;
mod n3v;
mod n3v_faults;
mod nerfies;
mod pixels;
mod real;
pub mod support;

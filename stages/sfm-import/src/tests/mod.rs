//! Tests on small generated captures, and on real captures where `PIPELINE_DATA` names their folder.

mod blender;
mod blender_layouts;
mod blender_lens;
mod bounds;
mod colmap;
mod colmap_files;
mod colmap_layouts;
mod estimators;
mod foreign;
mod fuzz;
mod fuzz_arrays;
mod fuzz_rigs;
mod inspect;
mod lens;
mod llff;
mod n3v;
mod n3v_faults;
mod nerfies;
mod nerfstudio;
mod nerfstudio_files;
mod pixels;
mod real;
mod real_transforms;
mod rigs;
pub(crate) mod support;
mod triangulate;
mod videos;

//! Transforms files, which NeRF (Mildenhall et al. 2020) introduced and D-NeRF, instant-ngp and nerfstudio extended:
//! what split files (`blender`) and a single file (`nerfstudio`) share.
//!
//! `camera_angle_x` is the horizontal field of view in radians. `transform_matrix` maps camera to world coordinates with
//! OpenGL's axes (x right, y up, looking along −z). `time` is usually in [0, 1] and missing for a static scene.
//! `file_path` names an image, with or without its extension.

mod cloud;
mod companions;
mod document;
mod frames;
mod listed;
mod stated_bounds;
mod stated_lens;
mod timing;

pub(crate) use self::cloud::cloud;
pub(crate) use self::companions::set_pixels;
pub(crate) use self::document::{StatedFrame, TransformsFile};
pub(crate) use self::frames::frames;
pub(crate) use self::listed::{ListedFrame, drop_repeated, image_path, relative};
pub(crate) use self::stated_bounds::stated_bounds;
pub(crate) use self::timing::{
    Splits, between_frames, is_static, long_gap, number_by_time, number_static, other_unit, time_map,
};

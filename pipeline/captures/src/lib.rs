//! Shared by the stages that write or read captures: the artifact type, parallel work on views, and the files that
//! views need.
//!
//! `engine` does not know scenes, and `scene` does not know the engine. This crate connects the two.

mod changes;
mod map_files;
mod memo;
mod offset;
mod per_view;
mod sizes;
pub mod video;
mod view_files;

pub use changes::shift_by_changes;
pub use map_files::{MapFile, MapFiles, frame_numbers};
pub use memo::Memo;
pub use offset::{better_shift, record_shift};
pub use per_view::per_view;
pub use sizes::{all_views, pixels_per_view, view_count, with_sizes};
pub use view_files::{match_required, open_folder};

engine::artifact! {
    /// A capture as an artifact: written by `scene-synthesis` and `sfm-import`, read by most other stages.
    pub struct CaptureArtifact(scene::Capture) = "capture" @ scene::capture::SCHEMA;
}

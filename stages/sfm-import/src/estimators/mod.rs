//! Clips whose cameras and depth come from a feed-forward estimator: poses and depth share one gauge, so depth needs no
//! alignment, and the depth of the training frames also gives the points.

pub(crate) mod megasam;
pub(crate) mod monst3r;
pub(crate) mod vggt;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use scene::{Camera, Split, npy_file};

use crate::cloud_file::CloudSource;
use crate::depth::DepthFile;
use crate::error::{Result, bad};
use crate::image_names::{natural_order, view_name};
use crate::lens::Lens;
use crate::params::{Format, Params};
use crate::source::{Frame, SourceCapture};
use crate::stored_image::StoredImage;
use crate::video_maps::{ArrayImage, Confidence, StoredDepth, VideoMaps, Window};
use crate::{files, rig, split};

/// An estimator's results for the frames of a clip, in the order in which it stores them.
struct Clip {
    format: Format,
    /// The file of poses.
    stated_in: PathBuf,
    /// The cameras of the images.
    cameras: Vec<Camera>,
    images: Images,
    depth: Arc<VideoMaps>,
    confidence: Option<Arc<VideoMaps>>,
    window: Option<Window>,
    /// Depths at or beyond this value mean that no depth was found.
    no_depth_from: f32,
    /// A mask per frame, or none at all.
    masks: Vec<Option<PathBuf>>,
    warnings: Vec<String>,
}

/// The images of a clip.
enum Images {
    /// A file per frame.
    Files(Vec<PathBuf>),
    /// An array of all frames, with the value of white.
    Array { images: Arc<VideoMaps>, white: f32 },
}

impl Clip {
    /// The capture: frames of one video, in the natural order of their names.
    fn capture(self, dir: &Path, params: &Params) -> SourceCapture {
        let confidence = self.confidence.clone().map(|maps| Confidence::new(maps, params.unsure_share));
        let mut frames: Vec<Frame> = (0..self.cameras.len()).map(|at| self.frame(at, confidence.as_ref())).collect();
        frames.sort_by(|a, b| natural_order(&a.name, &b.name));
        for (index, frame) in (0_u32..).zip(&mut frames) {
            frame.frame_index = index;
            frame.time_secs = f64::from(index) / params.fps;
        }
        let rules = vec![split::hold_out(&mut frames, params.is_static(), params)];
        let capture = rig::capture(dir, (self.format, self.format.name()), frames, rules, params);
        SourceCapture { cloud: Some(CloudSource::Depth), warnings: self.warnings, ..capture }
    }

    fn frame(&self, at: usize, confidence: Option<&Arc<Confidence>>) -> Frame {
        let Camera { intrinsics, camera_from_world } = self.cameras[at];
        let (name, image, stored_image) = match &self.images {
            Images::Files(paths) => (view_name(&files::name(&paths[at])), paths[at].clone(), None),
            Images::Array { images, white } => {
                let size = (intrinsics.width, intrinsics.height);
                let stored =
                    StoredImage::InArray(ArrayImage { images: images.clone(), index: at, white: *white, size });
                (format!("frame_{at:04}"), self.stated_in.clone(), Some(stored))
            }
        };
        let stored = StoredDepth {
            maps: self.depth.clone(),
            index: at,
            confidence: confidence.cloned(),
            window: self.window,
            no_depth_from: self.no_depth_from,
        };
        Frame {
            name,
            split: Split::Train,
            image,
            stored_image,
            mask: self.masks.get(at).cloned().flatten(),
            depth: Some(DepthFile::stored(self.depth.path(at).to_owned(), stored)),
            lens: Lens::pinhole(intrinsics),
            camera_from_world,
            camera_index: 0,
            frame_index: 0,
            time_secs: 0.0,
            stated_in: self.stated_in.clone(),
        }
    }
}

/// Reads an array of finite numbers in an archive.
fn array(path: &Path, name: &'static str) -> Result<npy_file::NpyArray> {
    shape(path, name)?;
    let array = npy_file::read_member(path, name).map_err(|error| bad(error.message).at(path))?;
    match array.values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(bad(format!("{name} contains {value}")).at(path)),
        None => Ok(array),
    }
}

/// The shape of an array in an archive.
fn shape(path: &Path, name: &'static str) -> Result<Vec<usize>> {
    let shape = npy_file::member_shape(path, name).map_err(|error| bad(error.message).at(path))?;
    shape.ok_or_else(|| bad(format!("the archive has no array {name}")).at(path))
}

/// The error for an array of another shape.
fn wrong_shape(name: &str, shape: &[usize], expected: &str, path: &Path) -> engine::Failure {
    bad(format!("{name} has the shape {shape:?} instead of {expected}")).at(path)
}

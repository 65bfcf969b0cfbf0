//! Writing a capture: equal content gives equal bytes, in any order of views.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use super::reading::{INDEX_FILE, POINTS_FILE, check_name, view_order};
use super::{Capture, Split, View};
use crate::cloud::PointCloud;
use crate::image_file::{self, GrayImage, RgbImage};
use crate::index_file;
use crate::maps::{DepthMap, FlowMap, LabelMap, VelocityMap};
use crate::ply::PlyFormat;
use crate::{Camera, Protocol, Result, TimeMap};

/// The description of a capture without its views; see [`Capture`].
#[derive(Clone, Debug)]
pub struct CaptureInfo {
    /// Name of the scene.
    pub name: String,
    /// Origin of the poses, e.g. `colmap`.
    pub pose_source: String,
    /// How the images were made.
    pub protocol: Protocol,
    /// The background colour of the images, sRGB-encoded in [0, 1].
    pub background: [f32; 3],
    /// Normalisation of time.
    pub time_map: TimeMap,
    /// Names of the instances in the masks, for the labels 1, 2, …
    pub class_names: Vec<String>,
    /// Bounding box of the scene (min, max corner, world), if known.
    pub bounds_world: Option<[[f64; 3]; 2]>,
}

/// A view with its pixels in memory; see [`View`].
#[derive(Clone, Debug)]
pub struct Frame {
    /// Name, unique within the capture and safe as a file name.
    pub name: String,
    /// The purpose of the view.
    pub split: Split,
    /// Intrinsics and pose.
    pub camera: Camera,
    /// Number of the camera in a rig; 0 for a monocular capture.
    pub camera_index: u32,
    /// Frame number within the video of that camera.
    pub frame_index: u32,
    /// Time of the image in seconds.
    pub time_secs: f64,
    /// Colours, composited on the background of the capture.
    pub image: RgbImage,
    /// Coverage before compositing, if known.
    pub alpha: Option<GrayImage>,
    /// View-space depth, if known.
    pub depth: Option<DepthMap>,
    /// Forward optical flow, if known.
    pub flow: Option<FlowMap>,
    /// Instance labels, if known.
    pub mask: Option<LabelMap>,
    /// 3D velocity of the visible surface, if known.
    pub velocity: Option<VelocityMap>,
}

/// Writes a capture into a folder, view by view, from any number of threads.
pub struct CaptureWriter {
    dir: PathBuf,
    info: CaptureInfo,
    has_points: bool,
    views: Mutex<Vec<View>>,
}

impl CaptureWriter {
    /// Starts a capture in the folder `dir` and creates the folder if it is missing.
    pub fn create(dir: &Path, info: CaptureInfo) -> Result<Self> {
        index_file::create_dir(dir)?;
        Ok(Self { dir: dir.into(), info, has_points: false, views: Mutex::default() })
    }

    /// Writes the files of one view; a map that is `None` has no file.
    pub fn write_view(&self, frame: &Frame) -> Result<()> {
        let Frame { name, split, camera, camera_index, frame_index, time_secs, .. } = frame;
        check_name(name)?;
        let write_exr = |kind, write: &dyn Fn(&Path) -> Result<()>| self.write_as(kind, &format!("{name}.exr"), write);
        let write_png = |kind, write: &dyn Fn(&Path) -> Result<()>| self.write_as(kind, &format!("{name}.png"), write);
        let view = View {
            name: name.clone(),
            split: *split,
            camera: *camera,
            camera_index: *camera_index,
            frame_index: *frame_index,
            time_secs: *time_secs,
            image: write_png("images", &|path| image_file::write_rgb(path, &frame.image))?,
            alpha: frame
                .alpha
                .as_ref()
                .map(|alpha| write_png("alpha", &|path| image_file::write_grey(path, alpha)))
                .transpose()?,
            depth: frame.depth.as_ref().map(|map| write_exr("depth", &|path| map.write(path))).transpose()?,
            flow: frame.flow.as_ref().map(|map| write_exr("flow", &|path| map.write(path))).transpose()?,
            mask: frame.mask.as_ref().map(|map| write_png("masks", &|path| map.write(path))).transpose()?,
            velocity: frame.velocity.as_ref().map(|map| write_exr("velocity", &|path| map.write(path))).transpose()?,
        };
        self.views.lock().expect("no thread panics while it holds the lock").push(view);
        Ok(())
    }

    /// Writes the point cloud of the capture.
    pub fn write_points(&mut self, points: &PointCloud) -> Result<()> {
        points.write_ply(&self.dir.join(POINTS_FILE), PlyFormat::BinaryLittleEndian)?;
        self.has_points = true;
        Ok(())
    }

    /// Sorts the views, checks the capture, and writes `capture.json` last.
    pub fn finish(self) -> Result<Capture> {
        let CaptureInfo { name, pose_source, protocol, background, time_map, class_names, bounds_world } = self.info;
        let mut views = self.views.into_inner().expect("no thread panics while it holds the lock");
        views.sort_by(view_order);
        let has_points = self.has_points;
        let dir = self.dir;
        let capture = Capture {
            dir,
            name,
            pose_source,
            protocol,
            background,
            time_map,
            views,
            class_names,
            has_points,
            bounds_world,
        };
        capture.check()?;
        index_file::write(&capture.dir.join(INDEX_FILE), "a capture", &capture)?;
        Ok(capture)
    }

    /// Writes `kind/file` below the folder of the capture and returns this relative path.
    fn write_as(&self, kind: &str, file: &str, write: &dyn Fn(&Path) -> Result<()>) -> Result<PathBuf> {
        index_file::create_dir(&self.dir.join(kind))?;
        let relative = Path::new(kind).join(file);
        write(&self.dir.join(&relative))?;
        Ok(relative)
    }
}

//! Writing a capture: equal content gives equal bytes, in whatever order views arrive.

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

/// What is known of a capture besides its views; fields as in [`Capture`].
#[derive(Clone, Debug)]
pub struct CaptureInfo {
    /// The scene's name.
    pub name: String,
    /// Where the poses come from.
    pub pose_source: String,
    /// How the images came to be what they are.
    pub protocol: Protocol,
    /// The colour that images were composited on.
    pub background: [f32; 3],
    /// Seconds to [0, 1].
    pub time_map: TimeMap,
    /// Names of the instances in the masks.
    pub class_names: Vec<String>,
    /// The box that holds the scene.
    pub bounds_world: Option<[[f64; 3]; 2]>,
}

/// A view with its pixels in memory; fields as in [`View`].
#[derive(Clone, Debug)]
pub struct Frame {
    /// Unique within the capture, safe as a file name.
    pub name: String,
    /// What the view may be used for.
    pub split: Split,
    /// Pinhole and pose.
    pub camera: Camera,
    /// Which camera of a rig.
    pub camera_index: u32,
    /// Frame number within that camera's video.
    pub frame_index: u32,
    /// When the image was taken.
    pub time_secs: f64,
    /// Composited on the capture's background.
    pub image: RgbImage,
    /// Coverage before compositing.
    pub alpha: Option<GrayImage>,
    /// View-space z.
    pub depth: Option<DepthMap>,
    /// Forward optical flow.
    pub flow: Option<FlowMap>,
    /// Instance labels.
    pub mask: Option<LabelMap>,
    /// 3D velocity.
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
    /// Starts a capture in the folder `dir`, which is created if need be.
    pub fn create(dir: &Path, info: CaptureInfo) -> Result<Self> {
        index_file::create_dir(dir)?;
        Ok(Self { dir: dir.into(), info, has_points: false, views: Mutex::default() })
    }

    /// Writes the files of one view; maps that are `None` leave no file behind.
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

    /// Sorts the views, checks everything, and writes `capture.json` last.
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

    /// Writes `kind/file` in the capture's folder and returns that relative path.
    fn write_as(&self, kind: &str, file: &str, write: &dyn Fn(&Path) -> Result<()>) -> Result<PathBuf> {
        index_file::create_dir(&self.dir.join(kind))?;
        let relative = Path::new(kind).join(file);
        write(&self.dir.join(&relative))?;
        Ok(relative)
    }
}

//! Opening and checking a capture, and loading the files of its views.

use std::collections::BTreeSet;
use std::path::Path;

use super::{BACKGROUND, Capture, Split, View};
use crate::cloud::PointCloud;
use crate::image_file::{self, GrayImage, RgbImage};
use crate::index_file::{self, ViewFiles};
use crate::maps::{DepthMap, FlowMap, LabelMap, VelocityMap};
use crate::{Error, Result};

/// Name of the index file.
pub(super) const INDEX_FILE: &str = "capture.json";
/// Name of the file of the point cloud.
pub(super) const POINTS_FILE: &str = "points.ply";

/// Hint for maps that do not match the views.
const OTHER_CAPTURE: &str = "they may belong to another capture";

/// Coarsest usable f32 step of the coordinates, relative to the extent of the scene.
const MAX_COORDINATE_STEP: f64 = 1e-2;
/// Tolerance for rounded times, relative to the duration of the capture, or to 1 s if that is longer.
const TIME_TOLERANCE: f64 = 1e-6;

impl Capture {
    /// Reads `capture.json` in `dir` without further checks; see [`Capture::check`].
    pub fn open(dir: &Path) -> Result<Self> {
        let path = dir.join(INDEX_FILE);
        Ok(Self { dir: dir.into(), ..index_file::read(&path, "a capture")? })
    }

    /// Checks everything that readers rely on: unique names in order, valid cameras, times within the time map, at
    /// least one training view, one resolution, and files of the right size with the right channels. Reads only headers
    /// of files.
    pub fn check(&self) -> Result<()> {
        self.check_index().map_err(|error| error.at(self.dir.join(INDEX_FILE)))?;
        for view in &self.views {
            self.check_files(view)?;
        }
        if self.has_points && !self.dir.join(POINTS_FILE).is_file() {
            return Err(Error::new("the point cloud is missing").at(self.dir.join(POINTS_FILE)));
        }
        Ok(())
    }

    /// The views of one split with their indices in [`Capture::views`].
    pub fn views_of(&self, split: Split) -> impl Iterator<Item = (usize, &View)> {
        self.views.iter().enumerate().filter(move |(_, view)| view.split == split)
    }

    /// Reads the image of a view: 8-bit colours, composited on the background.
    pub fn load_image(&self, view: &View) -> Result<RgbImage> {
        let image = image_file::read_rgb(&self.dir.join(&view.image))?;
        self.files(view).check_size(&view.image, (image.width(), image.height()))?;
        Ok(image)
    }

    /// Reads the coverage of a view before compositing, if it has any.
    pub fn load_alpha(&self, view: &View) -> Result<Option<GrayImage>> {
        self.files(view).load(view.alpha.as_deref(), image_file::read_grey, GrayImage::dimensions)
    }

    /// Reads the view-space depth of a view, if it has any.
    pub fn load_depth(&self, view: &View) -> Result<Option<DepthMap>> {
        self.files(view).load(view.depth.as_deref(), DepthMap::read, |map| (map.width, map.height))
    }

    /// Reads the forward optical flow of a view, if it has any.
    pub fn load_flow(&self, view: &View) -> Result<Option<FlowMap>> {
        self.files(view).load(view.flow.as_deref(), FlowMap::read, |map| (map.width, map.height))
    }

    /// Reads the velocity of the visible surface of a view, if it has any.
    pub fn load_velocity(&self, view: &View) -> Result<Option<VelocityMap>> {
        self.files(view).load(view.velocity.as_deref(), VelocityMap::read, |map| (map.width, map.height))
    }

    /// Reads the instance labels of a view, if it has any. A label without a class name is an error.
    pub fn load_mask(&self, view: &View) -> Result<Option<LabelMap>> {
        let mask = self.files(view).load(view.mask.as_deref(), LabelMap::read, |map| (map.width, map.height))?;
        let highest = mask.iter().flat_map(|mask| &mask.labels).max().copied().unwrap_or(0);
        if usize::from(highest) > self.class_names.len() {
            let message = format!(
                "label {highest} in the mask of {}, but only {} class names",
                view.name,
                self.class_names.len()
            );
            return Err(Error::new(message).at(self.dir.join(INDEX_FILE)));
        }
        Ok(mask)
    }

    /// Names of the mask labels 0, 1, …
    pub fn label_names(&self) -> impl Iterator<Item = &str> {
        std::iter::once(BACKGROUND).chain(self.class_names.iter().map(String::as_str))
    }

    /// Reads the point cloud, if the capture has one.
    pub fn load_points(&self) -> Result<Option<PointCloud>> {
        self.has_points.then(|| PointCloud::read_ply(&self.dir.join(POINTS_FILE))).transpose()
    }

    /// Checks that maps belong to this capture: one name per view, in the order of the views.
    pub fn check_names<'a>(&self, names: impl ExactSizeIterator<Item = &'a str>) -> Result<()> {
        let (count, expected) = (names.len(), self.views.len());
        if count != expected {
            return Err(
                Error::new(format!("maps of {count} views for a capture of {expected} views")).hint(OTHER_CAPTURE)
            );
        }
        match self.views.iter().zip(names).find(|(view, name)| view.name != *name) {
            None => Ok(()),
            Some((view, name)) => {
                Err(Error::new(format!("maps of view {name} instead of {}", view.name)).hint(OTHER_CAPTURE))
            }
        }
    }

    /// Checks the index alone.
    fn check_index(&self) -> Result<()> {
        self.time_map.check()?;
        let mut names = BTreeSet::new();
        for view in &self.views {
            let blame = |error: Error| Error { message: format!("view {}: {}", view.name, error.message), ..error };
            self.check_view(view).map_err(blame)?;
            if !names.insert(view.name.as_str()) {
                return Err(Error::new(format!("two views have the name {}", view.name)));
            }
        }
        if let Some(pair) = self.views.windows(2).find(|pair| view_order(&pair[0], &pair[1]).is_gt()) {
            let message = format!("view {} comes after {}", pair[1].name, pair[0].name);
            return Err(Error::new(message).hint("order views by split, time and camera"));
        }
        if self.views_of(Split::Train).next().is_none() {
            return Err(Error::new(format!("none of the {} views is a training view", self.views.len())));
        }
        if !self.background.iter().all(|value| (0.0..=1.0).contains(value)) {
            return Err(Error::new(format!("background {:?} is not a colour in [0, 1]", self.background)));
        }
        self.check_bounds()?;
        self.check_coordinates()
    }

    /// Checks the name, camera, size and time of one view.
    fn check_view(&self, view: &View) -> Result<()> {
        check_name(&view.name)?;
        view.camera.check()?;
        let size = (view.camera.intrinsics.width, view.camera.intrinsics.height);
        if size != (self.protocol.width, self.protocol.height) {
            let (width, height) = (self.protocol.width, self.protocol.height);
            return Err(Error::new(format!("{}×{} pixels, but the protocol has {width}×{height}", size.0, size.1)));
        }
        let slack_secs = TIME_TOLERANCE * (self.time_map.end_secs - self.time_map.start_secs).max(1.0);
        let (start_secs, end_secs) = (self.time_map.start_secs - slack_secs, self.time_map.end_secs + slack_secs);
        if !(view.time_secs >= start_secs && view.time_secs <= end_secs) {
            let map = &self.time_map;
            let message =
                format!("time {} s is outside the range {} to {} s", view.time_secs, map.start_secs, map.end_secs);
            return Err(Error::new(message));
        }
        Ok(())
    }

    /// Checks that the bounds are ordered and finite.
    fn check_bounds(&self) -> Result<()> {
        let Some([low, high]) = self.bounds_world else { return Ok(()) };
        let ordered = low.iter().zip(&high).all(|(low, high)| low <= high && low.is_finite() && high.is_finite());
        if ordered {
            Ok(())
        } else {
            Err(Error::new(format!("the bounds are not ordered and finite: {low:?} to {high:?}")))
        }
    }

    /// Checks that f32 positions, which models use, resolve the scene: coordinates far from the origin leave too few
    /// digits.
    fn check_coordinates(&self) -> Result<()> {
        let centers = self.views.iter().map(|view| view.camera.position_world().abs().max_element());
        let largest = centers.fold(0.0_f64, f64::max);
        let step = largest * f64::from(f32::EPSILON);
        let extent = self.scale().extent;
        if step <= MAX_COORDINATE_STEP * extent {
            return Ok(());
        }
        let message =
            format!("coordinates up to {largest:.1e} for a scene of extent {extent:.1e} exceed the precision of f32");
        Err(Error::new(message).hint("subtract the offset of the coordinate system from all poses and points"))
    }

    /// Checks that the files of a view lie below the folder, with the right size and channels.
    fn check_files(&self, view: &View) -> Result<()> {
        let files = self.files(view);
        for file in [Some(&view.image), view.alpha.as_ref(), view.mask.as_ref()].into_iter().flatten() {
            files.check_image(file)?;
        }
        let [flow_x, flow_y] = &FlowMap::CHANNELS;
        let [x, y, z] = &VelocityMap::CHANNELS;
        let floats: [(_, &[&[&str]]); 3] = [
            (&view.depth, &[&DepthMap::CHANNELS]),
            (&view.flow, &[flow_x, flow_y]),
            (&view.velocity, &[&[x], &[y], &[z]]),
        ];
        let mut present = floats.iter().filter_map(|(file, channels)| Some((file.as_ref()?, channels)));
        present.try_for_each(|(file, channels)| files.check_floats(file, channels))
    }

    /// Access to the files of a view.
    fn files(&self, view: &View) -> ViewFiles<'_> {
        ViewFiles::of(&self.dir, &view.camera.intrinsics)
    }
}

/// The order of views: split, time, camera; the frame and the name make it total.
pub(super) fn view_order(a: &View, b: &View) -> std::cmp::Ordering {
    let rest = |view: &View| (view.camera_index, view.frame_index);
    let by_split = a.split.cmp(&b.split);
    let by_time = by_split.then(a.time_secs.total_cmp(&b.time_secs));
    by_time.then(rest(a).cmp(&rest(b))).then_with(|| a.name.cmp(&b.name))
}

/// Checks that a view name is safe as a file name.
pub(super) fn check_name(name: &str) -> Result<()> {
    let safe = |symbol: char| symbol.is_ascii_alphanumeric() || "_-.".contains(symbol);
    if !name.is_empty() && !name.starts_with('.') && name.chars().all(safe) {
        return Ok(());
    }
    Err(Error::new(format!("{name:?} is not safe as a file name")).hint("use letters, digits, _, - and ."))
}

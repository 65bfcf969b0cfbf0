//! A preparation: its input, its steps and its settings.

use std::path::{Path, PathBuf};

use crate::check_steps;
use crate::error::{Result, bad};

/// The steps that COLMAP runs, in their order.
pub(crate) const COLMAP_STEPS: [&str; 3] = ["features", "matches", "mapping"];

/// A video or a folder of images, and how to turn it into a capture.
#[derive(Clone, Debug)]
pub struct Request {
    /// A video file, or a folder of images (or of one folder of images per camera).
    pub input: PathBuf,
    /// The folder of the capture, which is created.
    pub out: PathBuf,
    /// Frames per second to take from a video; for images, the rate at which they were taken.
    pub fps: Option<f64>,
    /// Maximum number of frames to take from a video without `fps`; 300 if unset.
    pub max_frames: Option<u32>,
    /// Longest side of frames of a video in pixels, 1920 if unset; smaller videos are not enlarged.
    pub max_side: Option<u32>,
    /// First second of the video to use.
    pub start_secs: Option<f64>,
    /// Second of the video at which to stop.
    pub end_secs: Option<f64>,
    /// A folder of masks with the names of the images, set where something moves.
    pub masks: Option<PathBuf>,
    /// A TOML file of estimators.
    pub estimators: Option<PathBuf>,
    /// The camera model of COLMAP.
    pub camera_model: CameraModel,
    /// The image pairs that COLMAP compares.
    pub matcher: Matcher,
    /// Steps to run again.
    pub force: Vec<String>,
    /// The last step to run.
    pub until: Option<String>,
}

/// A camera model of COLMAP.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CameraModel {
    /// A pinhole if estimators make maps of the frames, because the maps would otherwise need the same undistortion;
    /// else one radial coefficient.
    #[default]
    Auto,
    /// One focal length, no distortion.
    SimplePinhole,
    /// One focal length and one radial coefficient.
    SimpleRadial,
    /// Two focal lengths, two radial and two tangential coefficients.
    Opencv,
}

/// The image pairs that COLMAP compares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Matcher {
    /// All pairs of few or unordered images, and neighbours in long videos.
    #[default]
    Auto,
    /// All pairs.
    Exhaustive,
    /// Neighbours in the order of the names.
    Sequential,
}

impl Request {
    /// Checks the values that the types do not restrict, and refuses options without effect; `steps` has the names of all
    /// steps.
    pub(crate) fn check(&self, steps: &[String]) -> Result<()> {
        check_steps(self.force.iter().chain(&self.until), steps)?;
        self.check_effects()?;
        let positive = |value: f64| value > 0.0 && value.is_finite();
        if !self.fps.is_none_or(positive) {
            return Err(bad("--fps must be positive").hint("e.g. --fps 10"));
        }
        let start = self.start_secs.unwrap_or(0.0);
        if !(start >= 0.0 && self.end_secs.is_none_or(|end| end > start && end.is_finite())) {
            return Err(bad("--end must be later than --start, both in seconds").hint("e.g. --start 2 --end 7.5"));
        }
        Ok(())
    }

    /// Refuses options that would have no effect.
    fn check_effects(&self) -> Result<()> {
        let choice = "remove the images that are not wanted";
        let of_videos = [
            (self.start_secs.is_some(), "--start", choice),
            (self.end_secs.is_some(), "--end", choice),
            (self.max_frames.is_some(), "--max-frames", choice),
            (self.max_side.is_some(), "--max-side", "shrink the images first"),
        ];
        let given = of_videos.into_iter().find(|(is_given, ..)| *is_given && self.input.is_dir());
        if let Some((_, option, hint)) = given {
            return Err(bad(format!("{option} is an option for videos")).hint(hint));
        }
        if self.fps.is_some() && self.max_frames.is_some() {
            return Err(bad("--max-frames has no effect with --fps").hint("omit one of them; --end also limits frames"));
        }
        Ok(())
    }

    /// Checks that the given files and folders exist.
    pub(crate) fn check_paths(&self) -> Result<()> {
        let missing = |what: &str, path: &Path| Err(bad(format!("no such {what}")).at(path));
        if !self.input.exists() {
            return missing("file or folder", &self.input);
        }
        match (&self.masks, &self.estimators) {
            (Some(masks), _) if !masks.is_dir() => missing("folder (--masks)", masks),
            (_, Some(estimators)) if !estimators.is_file() => missing("file (--estimators)", estimators),
            _ => Ok(()),
        }
    }
}

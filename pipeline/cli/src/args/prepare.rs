//! The options of `prepare`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use prepare::{CameraModel, Matcher, Request};

/// A video or a folder of images, and how to make a capture of it.
#[derive(Debug, Args)]
pub(crate) struct PrepareArgs {
    /// A video, a folder of images, or a folder with one folder of images per camera
    #[arg(value_name = "VIDEO|IMAGES")]
    input: PathBuf,
    /// Folder of the capture, which is created
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Frames per second to take from a video; for images, the rate at which they were taken (default: that of the
    /// video, divided so that --max-frames suffice; 30 for images)
    #[arg(long, value_name = "RATE")]
    fps: Option<f64>,
    /// Maximum number of frames to take from a video without --fps (default: 300)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    max_frames: Option<u32>,
    /// Longest side of frames of a video, in pixels (default: 1920); smaller videos are not enlarged
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(16..=16384))]
    max_side: Option<u32>,
    /// Start of the clip, in seconds of the video
    #[arg(long, value_name = "SECONDS")]
    start: Option<f64>,
    /// End of the clip, in seconds of the video
    #[arg(long, value_name = "SECONDS")]
    end: Option<f64>,
    /// Folder of masks: PNG files with the names of the images, nonzero where something moves. The estimation of camera
    /// poses ignores these pixels
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// TOML file with commands that estimate depth, flow, masks, …: [[estimator]] with name, kind, command with {frames}
    /// and {out}, and optionally version and import (see pipeline/prepare/README.md)
    #[arg(long, value_name = "FILE")]
    estimators: Option<PathBuf>,
    /// Camera model of COLMAP (auto: simple-pinhole if estimators make maps of the frames, otherwise simple-radial)
    #[arg(long, value_enum, default_value_t)]
    camera_model: CameraModelArg,
    /// Image pairs that COLMAP compares (auto: all pairs of few images, otherwise neighbours in time)
    #[arg(long, value_enum, default_value_t)]
    matcher: MatcherArg,
    /// Run this step again: frames, masks, features, matches, mapping, or the name of an estimator; can be repeated
    #[arg(long, value_name = "STEP")]
    force: Vec<String>,
    /// Stop after this step, e.g. frames, to draw masks on DIR/images
    #[arg(long, value_name = "STEP")]
    until: Option<String>,
}

/// A camera model of COLMAP.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum CameraModelArg {
    #[default]
    Auto,
    SimplePinhole,
    SimpleRadial,
    Opencv,
}

/// The image pairs that COLMAP compares.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum MatcherArg {
    #[default]
    Auto,
    Exhaustive,
    Sequential,
}

impl PrepareArgs {
    /// What to prepare.
    pub(crate) fn request(&self) -> Request {
        Request {
            input: self.input.clone(),
            out: self.out.clone(),
            fps: self.fps,
            max_frames: self.max_frames,
            max_side: self.max_side,
            start_secs: self.start,
            end_secs: self.end,
            masks: self.masks.clone(),
            estimators: self.estimators.clone(),
            camera_model: match self.camera_model {
                CameraModelArg::Auto => CameraModel::Auto,
                CameraModelArg::SimplePinhole => CameraModel::SimplePinhole,
                CameraModelArg::SimpleRadial => CameraModel::SimpleRadial,
                CameraModelArg::Opencv => CameraModel::Opencv,
            },
            matcher: match self.matcher {
                MatcherArg::Auto => Matcher::Auto,
                MatcherArg::Exhaustive => Matcher::Exhaustive,
                MatcherArg::Sequential => Matcher::Sequential,
            },
            force: self.force.clone(),
            until: self.until.clone(),
        }
    }
}

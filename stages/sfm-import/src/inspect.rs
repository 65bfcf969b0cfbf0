//! What a folder holds, in words: for people before they write a recipe, and as data for programs.

mod recipe;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use engine::Failure;
use scene::{Intrinsics, Split};
use serde::Serialize;

use crate::Params;
use crate::colmap::model::ReprojectionError;
use crate::params::Format;
use crate::recognise::{captures_below, recognise};
use crate::source::{self, Quality, SourceCapture};

/// Problems that are printed one by one.
const LISTED_PROBLEMS: usize = 8;

/// One folder, as far as it could be read.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The folder.
    pub path: PathBuf,
    /// What it was recognised as; `Auto` where it was not.
    pub format: Format,
    /// The frames, where there are any and the files that name them could be read.
    pub frames: Option<Frames>,
    /// Odd, but not wrong.
    pub warnings: Vec<String>,
    /// What makes it unusable, each with a hint and a file.
    pub problems: Vec<Failure>,
    /// Parameters of an import with their values in TOML, beyond the source, where it is usable.
    pub params: Option<Vec<(&'static str, String)>>,
}

/// What the frames of a capture are.
#[derive(Clone, Debug, Serialize)]
pub struct Frames {
    /// Images by split.
    pub counts: BTreeMap<Split, usize>,
    /// Cameras; each frame of a scene at rest counts as one.
    pub cameras: usize,
    /// The first view's native size, focal lengths and principal point.
    pub intrinsics: Intrinsics,
    /// Horizontal field of view in degrees.
    pub fov_x_degrees: f64,
    /// Whether images are undistorted on import.
    pub distorted: bool,
    /// First and last instant; `None` for a scene at rest.
    pub time_range_secs: Option<[f64; 2]>,
    /// Duration of one frame.
    pub frame_secs: f64,
    /// Images with a mask.
    pub masks: usize,
    /// Points of the sparse cloud.
    pub points: usize,
    /// How well structure from motion went.
    pub quality: Option<Quality>,
}

/// A folder that was looked at.
pub struct Inspection {
    dir: PathBuf,
    /// The capture in it, or every capture directly below it.
    pub captures: Vec<Summary>,
}

/// Looks at the capture in `dir`, or at every capture directly below it; an error only where there is nothing to look at.
pub fn inspect(dir: &Path) -> anyhow::Result<Inspection> {
    let dir = dir.canonicalize().with_context(|| format!("cannot open the folder: {}", dir.display()))?;
    let below = captures_below(&dir);
    let captures = if recognise(&dir, Format::Auto).is_err() && !below.is_empty() {
        below.iter().map(|path| Summary::of(path)).collect()
    } else {
        vec![Summary::of(&dir)]
    };
    Ok(Inspection { dir, captures })
}

impl Inspection {
    /// The description for a person.
    pub fn text(&self) -> String {
        let mut text = self.captures.iter().map(Summary::text).collect::<Vec<_>>().join("\n");
        if self.captures.len() > 1 {
            let ready = self.captures.iter().filter(|summary| summary.params.is_some()).count();
            write!(text, "\n{ready} of {} captures are ready\n", self.captures.len()).expect("strings do not fail");
        }
        let indented = |recipe: String| recipe.lines().map(|line| format!("  {line}\n")).collect::<String>();
        text + &self.recipe().map(|recipe| format!("\n{}", indented(recipe))).unwrap_or_default()
    }

    /// A recipe that trains on every capture that is ready, to be saved beside the common ones; none where none is.
    pub fn recipe(&self) -> Option<String> {
        recipe::of(&self.dir, &self.captures)
    }
}

impl Summary {
    /// Looks at everything but pixels.
    fn of(dir: &Path) -> Self {
        let format = recognise(dir, Format::Auto).unwrap_or_default();
        let unread = |failure| Self {
            path: dir.into(),
            format,
            frames: None,
            warnings: Vec::new(),
            problems: vec![failure],
            params: None,
        };
        match source::read(dir, &Params::default()) {
            Err(failure) => unread(failure),
            Ok(source) => {
                let problems = source.problems();
                let frames = Frames::of(&source);
                let usable = frames.as_ref().filter(|_| problems.is_empty());
                let params = usable.map(|frames| recipe::params(&source, frames.intrinsics.width));
                Self { path: dir.into(), format, frames, warnings: source.warnings, problems, params }
            }
        }
    }

    /// A few aligned lines.
    fn text(&self) -> String {
        let mut out = format!("{}\n", self.path.display());
        let mut line = |label: &str, value: &str| out += &format!("  {label:<12}{value}\n");
        line("format", self.format_name());
        if let Some(frames) = &self.frames {
            frames.lines().iter().for_each(|(label, value)| line(label, value));
        }
        self.warnings.iter().for_each(|warning| line("note", warning));
        self.problems.iter().take(LISTED_PROBLEMS).for_each(|problem| line("problem", &problem.to_string()));
        match self.problems.len().saturating_sub(LISTED_PROBLEMS) {
            0 if self.problems.is_empty() => {
                line("verdict", "ready to import, as far as is known without decoding an image");
            }
            0 => line("verdict", "cannot be imported before the problems are solved"),
            more => line("verdict", &format!("cannot be imported: {more} more problems like these")),
        }
        out
    }

    fn format_name(&self) -> &'static str {
        let timed = self.frames.as_ref().map(|frames| frames.time_range_secs.is_some());
        match (self.format, timed) {
            (Format::Auto, _) => "not recognised",
            (Format::Blender, None) => "D-NeRF or Blender (transforms_*.json)",
            (Format::Blender, Some(true)) => "D-NeRF (Blender transforms_*.json with times)",
            (Format::Blender, Some(false)) => "Blender transforms_*.json without times (a scene at rest)",
            (Format::Colmap, _) => "COLMAP sparse model",
            (Format::Nerfies, _) => "Nerfies, HyperNeRF or DyCheck (a camera file per view)",
            (Format::N3v, _) => "Neural 3D Video (poses_bounds.npy and a folder of frames per camera)",
        }
    }
}

impl Frames {
    fn of(source: &SourceCapture) -> Option<Self> {
        let splits = [Split::Train, Split::Val, Split::Test];
        let time = source.time_map;
        let intrinsics = source.frames.first()?.lens.intrinsics;
        Some(Self {
            counts: splits.iter().map(|split| (*split, source.count(*split))).collect(),
            cameras: source.camera_count(),
            intrinsics,
            fov_x_degrees: (2.0 * (0.5 * f64::from(intrinsics.width) / intrinsics.focal_x).atan()).to_degrees(),
            distorted: source.frames.iter().any(|frame| !frame.lens.distortion.is_none()),
            time_range_secs: (time.end_secs > time.start_secs).then_some([time.start_secs, time.end_secs]),
            frame_secs: time.frame_secs,
            masks: source.frames.iter().filter(|frame| frame.mask.is_some()).count(),
            points: source.points.len(),
            quality: source.quality,
        })
    }

    fn lines(&self) -> Vec<(&'static str, String)> {
        let Intrinsics { width, height, focal_x, focal_y, .. } = self.intrinsics;
        let counts = self.counts.iter().filter(|(_, count)| **count > 0);
        let counts: Vec<String> =
            counts.map(|(split, n)| format!("{n} {}", format!("{split:?}").to_lowercase())).collect();
        let focal = if focal_x == focal_y { format!("{focal_x:.1}") } else { format!("{focal_x:.1} × {focal_y:.1}") };
        let lens = if self.distorted { "; distorted: images are undistorted on import" } else { "" };
        let mut lines = vec![
            ("images", format!("{width}×{height}; {}", counts.join(", "))),
            ("cameras", self.cameras_text()),
            ("focal", format!("{focal} px, {:.1}° wide{lens}", self.fov_x_degrees)),
            ("time", self.time_text()),
        ];
        if self.masks > 0 {
            lines.push(("masks", format!("{}", self.masks)));
        }
        if let Some(quality) = self.quality {
            lines.push(("poses", format!("{} of {} images registered", quality.registered, quality.images)));
            let known = quality.reprojection.filter(ReprojectionError::is_of_images);
            let error = known.map_or(String::new(), |error| {
                format!(
                    ", {:.2} px from their keypoints on average (COLMAP stored {:.2})",
                    error.recomputed_px, error.stored_px
                )
            });
            lines.push(("points", format!("{}{error}", self.points)));
        } else if self.points == 0 {
            lines.push(("points", "none (initial points are drawn at random)".into()));
        } else {
            lines.push(("points", self.points.to_string()));
        }
        lines
    }

    fn cameras_text(&self) -> String {
        match (self.time_range_secs, self.cameras) {
            (None, count) => format!("{count} at one instant"),
            (Some(_), 1) => "1, moving (one view per instant)".into(),
            (Some(_), count) => format!("{count} (a rig)"),
        }
    }

    fn time_text(&self) -> String {
        match self.time_range_secs {
            Some([start, end]) => format!("{start} to {end:.4} s, {:.4} s per frame", self.frame_secs),
            None => "one instant".into(),
        }
    }
}

//! What a folder holds, in words: for people before they write a recipe, and as data for programs.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use engine::Failure;
use scene::protocol::PRESETS;
use scene::{Intrinsics, Split};
use serde::Serialize;

use crate::Params;
use crate::params::Format;
use crate::recognise::{captures_below, recognise};
use crate::source::{self, Quality, SourceCapture};

/// Problems that are printed one by one.
const LISTED_PROBLEMS: usize = 8;

/// Pixels per row from which the recipe suggests half of them.
const LARGE_WIDTH: u32 = 800;

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
    /// A recipe node that imports it, where it is usable.
    pub recipe: Option<String>,
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

/// Describes the capture in `dir`, or every capture directly below it, for a person.
pub fn describe(dir: &Path) -> anyhow::Result<String> {
    let summaries = inspect(dir)?;
    let text: Vec<String> = summaries.iter().map(Summary::text).collect();
    let mut text = text.join("\n");
    if summaries.len() > 1 {
        write!(text, "\n{}", folder_recipe(dir, &summaries))?;
    }
    Ok(text)
}

/// The capture in `dir`, or every capture directly below it; an error only where there is nothing to look at.
pub fn inspect(dir: &Path) -> anyhow::Result<Vec<Summary>> {
    let dir = dir.canonicalize().with_context(|| format!("cannot open the folder: {}", dir.display()))?;
    let below = captures_below(&dir);
    if recognise(&dir, Format::Auto).is_err() && !below.is_empty() {
        return Ok(below.iter().map(|path| Summary::of(path)).collect());
    }
    Ok(vec![Summary::of(&dir)])
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
            recipe: None,
        };
        match source::read(dir, &Params::default()) {
            Err(failure) => unread(failure),
            Ok(source) => {
                let problems = source.problems();
                let frames = Frames::of(&source);
                let recipe = frames.as_ref().filter(|_| problems.is_empty()).map(|frames| recipe(&source, frames));
                Self { path: dir.into(), format, frames, warnings: source.warnings, problems, recipe }
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
            0 if self.problems.is_empty() => line("verdict", "ready to import"),
            0 => line("verdict", "cannot be imported before the problems are solved"),
            more => line("verdict", &format!("cannot be imported: {more} more problems like these")),
        }
        if let Some(recipe) = &self.recipe {
            let data_root = self.path.parent().unwrap_or(&self.path).display();
            write!(out, "\n  # recipe, with --data-root {data_root}\n{}", indented(recipe))
                .expect("strings do not fail");
        }
        out
    }

    fn format_name(&self) -> &'static str {
        let timed = self.frames.as_ref().is_some_and(|frames| frames.time_range_secs.is_some());
        match (self.format, timed) {
            (Format::Auto, _) => "not recognised",
            (Format::Blender, true) => "D-NeRF (Blender transforms_*.json with times)",
            (Format::Blender, false) => "Blender transforms_*.json without times (a scene at rest)",
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
            let error = quality.reprojection.map_or(String::new(), |error| {
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

/// A recipe node for one capture.
fn recipe(source: &SourceCapture, frames: &Frames) -> String {
    let mut params = vec![format!("source = {:?}", source.name)];
    let width = frames.intrinsics.width;
    if source.format == Format::N3v {
        params.extend(protocol_params(source, width));
    } else if width >= LARGE_WIDTH {
        params.push(format!("width = {}, resize = \"area\"", width / 2));
    }
    let mut note = "";
    if source.format == Format::Colmap {
        params.push("every_nth = 8, fps = 30.0".into());
        note = "# images are taken for the frames of a video in the order of their names;\n\
                # for photos of a scene at rest replace fps by static = true\n";
    } else if source.format == Format::Nerfies {
        params.push("fps = 30.0".into());
    } else if source.name == "lego" && source.dataset == "dnerf" {
        params.push("test_split = \"val\"".into());
    }
    format!("{note}[nodes.capture]\nstage = \"sfm-import\"\nparams = {{ {} }}\n", params.join(", "))
}

/// The size and the protocol that the literature has for the data set, where images of `width` can come to have them.
fn protocol_params(source: &SourceCapture, width: u32) -> Option<String> {
    let preset = PRESETS.iter().find(|preset| preset.protocol().dataset == source.dataset)?;
    let protocol = preset.protocol();
    if width <= protocol.width {
        return None;
    }
    let size = format!("width = {}, resize = {:?}", protocol.width, protocol.resize);
    let is_whole = source.split_rule == protocol.split;
    Some(if is_whole { format!("{size}, protocol = {:?}", preset.name) } else { size })
}

/// A recipe node for all captures of a folder that are ready.
fn folder_recipe(dir: &Path, summaries: &[Summary]) -> String {
    let ready = summaries.iter().filter(|summary| summary.recipe.is_some());
    let names: Vec<String> =
        ready.filter_map(|summary| Some(format!("{:?}", summary.path.file_name()?.to_str()?))).collect();
    let recipe = format!(
        "[axes]\nscene = [{}]\n[nodes.capture]\nstage = \"sfm-import\"\nover = [\"scene\"]\n\
         params = {{ source = \"{{scene}}\" }}\n",
        names.join(", ")
    );
    format!(
        "{} of {} captures are ready\n\n  # recipe for all of them, with --data-root {}\n{}",
        names.len(),
        summaries.len(),
        dir.display(),
        indented(&recipe)
    )
}

fn indented(text: &str) -> String {
    text.lines().map(|line| format!("  {line}\n")).collect()
}

//! The description of one capture.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::Failure;
use scene::statistics::median;
use scene::{Intrinsics, Split};
use serde::Serialize;

use super::companions::Companions;
use super::samples::Samples;
use super::{companions, ignored, suggestion, views};
use crate::colmap::one_instant;
use crate::depth_scale;
use crate::error::Result;
use crate::oddities::short;
use crate::params::{Format, Params};
use crate::recognise::{read, recognise};
use crate::source::{Quality, ReprojectionError, SourceCapture};

/// Maximum number of problems that are printed.
const LISTED_PROBLEMS: usize = 8;
/// Most decimals of a number.
const MOST_DECIMALS: f64 = 12.0;
/// Numbers from here on have an exponent; times in nanoseconds since 1970 do not.
const LARGE: f64 = 1e20;

/// The description of one capture, as far as its files could be read.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The capture's folder.
    pub path: PathBuf,
    /// The recognised format; `Auto` if no format was recognised.
    pub format: Format,
    /// The frames; `None` if there are no frames or their files could not be read.
    pub frames: Option<Frames>,
    /// Statistics of a few decoded images; `None` if the capture has other problems.
    pub samples: Option<Samples>,
    /// Files and folders of the capture that an import does not read, each with the reason if known.
    pub ignored: Vec<String>,
    /// Masks, depth and flow next to the frames of a video.
    pub companions: Companions,
    /// Oddities that do not prevent an import.
    pub warnings: Vec<String>,
    /// Problems that prevent an import, each with a hint and a file.
    pub problems: Vec<Failure>,
    /// Suggested import parameters besides `source`, with their values in TOML; `None` if the capture is not importable.
    pub params: Option<Vec<(&'static str, String)>>,
}

/// The frames of a capture.
#[derive(Clone, Debug, Serialize)]
pub struct Frames {
    /// Number of images per split.
    pub counts: BTreeMap<Split, usize>,
    /// Number of cameras; in a static scene each frame counts as one.
    pub cameras: usize,
    /// Number of cameras with training views.
    pub training_cameras: usize,
    /// The native size, focal lengths and principal point of the first view.
    pub intrinsics: Intrinsics,
    /// Least and greatest horizontal focal length of all views in pixels.
    pub focal_range_px: [f64; 2],
    /// Horizontal field of view in degrees.
    pub fov_x_degrees: f64,
    /// Whether any lens has distortion, which the import then removes.
    pub distorted: bool,
    /// First and last time; `None` for a static scene.
    pub time_range_secs: Option<[f64; 2]>,
    /// Duration of one frame.
    pub frame_secs: f64,
    /// Number of images with a mask.
    pub masks: usize,
    /// Number of images with a depth map.
    pub depths: usize,
    /// Scene units per stored unit of the depth maps, and the median depth of a few of them in scene units.
    pub depth_scale: Option<[f64; 2]>,
    /// The box in which random initial points are drawn.
    pub bounds_world: Option<[[f64; 3]; 2]>,
    /// Number of points in the sparse cloud.
    pub points: usize,
    /// Whether the import triangulates points from the images.
    pub searches_points: bool,
    /// The quality of structure from motion, for COLMAP models.
    pub quality: Option<Quality>,
}

impl Summary {
    /// Describes the capture in `dir` in the format `wanted`, and decodes at most `images` of its images.
    pub(super) fn of(dir: &Path, wanted: Format, images: usize) -> Self {
        let format = recognise(dir, wanted).unwrap_or_default();
        let unread = |failure| Self {
            path: dir.into(),
            format,
            frames: None,
            samples: None,
            ignored: Vec::new(),
            companions: Companions::default(),
            warnings: Vec::new(),
            problems: vec![failure],
            params: None,
        };
        let fps = companions::fps(dir).unwrap_or(Params::default().fps);
        let static_scene = (format == Format::ScanNet).then_some(true); // nothing moves in its recordings
        let params = Params { format: wanted, fps, static_scene, ..Params::default() };
        let at_rate = |source: SourceCapture| match suggestion::rate_of_videos(&source) {
            Some(fps) => read(dir, &Params { fps, ..params.clone() }),
            None => Ok(source),
        };
        match read(dir, &params).and_then(at_rate).and_then(|source| photos_as_one_instant(dir, source, params.clone()))
        {
            Err(failure) => unread(failure),
            Ok(source) => Self::of_source(dir, source, wanted, images),
        }
    }

    fn of_source(dir: &Path, source: SourceCapture, wanted: Format, images: usize) -> Self {
        let mut problems = source.problems();
        let samples = problems.is_empty().then(|| Samples::of(&source, images));
        let samples = samples.map(|(samples, damaged)| {
            problems.extend(damaged);
            samples
        });
        let frames = Frames::of(&source);
        let usable = frames.as_ref().filter(|_| problems.is_empty());
        let companions = usable.map(|frames| frames.companions(dir, &source)).unwrap_or_default();
        let named = (wanted != Format::Auto).then(|| ("format", format!("{:?}", wanted.name())));
        let params = usable.map(|frames| {
            let suggested = suggestion::params(&source, samples.as_ref(), &frames.intrinsics, &companions);
            named.into_iter().chain(suggested).collect()
        });
        let found = samples.iter().flat_map(Samples::warnings).chain(views::warnings(&source)).collect::<Vec<_>>();
        let ignored = ignored::lines(dir, source.format, &source.used_files());
        let warnings = source.warnings.into_iter().chain(found).collect();
        Self {
            path: dir.into(),
            format: source.format,
            frames,
            samples,
            ignored,
            companions,
            warnings,
            problems,
            params,
        }
    }

    /// The description as aligned lines.
    pub(super) fn text(&self) -> String {
        let mut out = format!("{}\n", self.path.display());
        let mut line = |label: &str, value: &str| out += &format!("  {label:<12}{value}\n");
        line("format", self.format_name());
        if let Some(frames) = &self.frames {
            frames.lines().iter().for_each(|(label, value)| line(label, value));
        }
        self.samples.iter().for_each(|samples| line("pixels", &samples.text()));
        self.ignored.iter().for_each(|entry| line("ignored", entry));
        self.warnings.iter().for_each(|warning| line("warning", warning));
        self.companions.missing().iter().for_each(|text| line("missing", text));
        let problems = self.grouped_problems();
        problems.iter().take(LISTED_PROBLEMS).for_each(|problem| line("problem", problem));
        match problems.len().saturating_sub(LISTED_PROBLEMS) {
            0 if problems.is_empty() => line("verdict", "ready to import"),
            0 => line("verdict", "cannot be imported until the problems are solved"),
            more => line("verdict", &format!("cannot be imported; {more} more problems of this kind")),
        }
        out
    }

    /// One line per kind of problem, with its first file and the number of others.
    fn grouped_problems(&self) -> Vec<String> {
        let mut groups: Vec<(&Failure, usize)> = Vec::new();
        for problem in &self.problems {
            let same = |(first, _): &&mut (&Failure, usize)| {
                (&first.message, &first.hint) == (&problem.message, &problem.hint)
            };
            match groups.iter_mut().find(same) {
                Some((_, count)) => *count += 1,
                None => groups.push((problem, 1)),
            }
        }
        let text = |(first, count): (&Failure, usize)| match count {
            1 => first.to_string(),
            _ => format!("{first} (and {} more like this)", count - 1),
        };
        groups.into_iter().map(text).collect()
    }

    fn format_name(&self) -> &'static str {
        let timed = self.frames.as_ref().map(|frames| frames.time_range_secs.is_some());
        match (self.format, timed) {
            (Format::Auto, _) => "not recognised",
            (Format::Blender, None) => "D-NeRF or Blender (transforms_*.json)",
            (Format::Blender, Some(true)) => "D-NeRF (Blender transforms_*.json with times)",
            (Format::Blender, Some(false)) => "Blender transforms_*.json without times (a static scene)",
            (Format::Nerfstudio, _) => "nerfstudio or instant-ngp (transforms.json)",
            (Format::Colmap, _) => "COLMAP sparse model",
            (Format::Nerfies, _) => "Nerfies, HyperNeRF or DyCheck (one camera file per view)",
            (Format::EasyVolcap, _) => "EasyVolcap: ENeRF-Outdoor, MobileStage (intri.yml, extri.yml)",
            (Format::Panoptic, _) => "CMU Panoptic",
            (Format::Technicolor, _) => "Technicolor light field (cameras_parameters.txt)",
            (Format::Llff, _) => "LLFF (poses_bounds.npy and images)",
            (Format::Nvidia, _) => "NVIDIA Dynamic Scene (poses_bounds.npy, images and mv_images)",
            (Format::N3v, _) => "Neural 3D Video (poses_bounds.npy and a video or folder of frames per camera)",
            (Format::ScanNet, _) => "ScanNet (color, depth, pose, intrinsic)",
            (Format::Immersive, _) => {
                "Immersive Light Field Video (models.json and a video or folder of frames per camera)"
            }
            (Format::Tum, _) => "RGB-D sequence of TUM, Bonn or ETH3D (rgb.txt, depth.txt, groundtruth.txt)",
            (Format::Vggt, _) => "VGGT (predictions.npz)",
            (Format::MegaSam, _) => "MegaSaM (npz of images, depth and poses)",
            (Format::Monst3r, _) => "MonST3R or DUSt3R (pred_traj.txt, pred_intrinsics.txt)",
        }
    }
}

/// Reads a capture of COLMAP or VGGT again, as views of one instant, if they are unlikely to be frames of a video. A capture that
/// `pipeline prepare` made from a video states its frame rate and is a video.
fn photos_as_one_instant(dir: &Path, source: SourceCapture, params: Params) -> Result<SourceCapture> {
    if !matches!(source.format, Format::Colmap | Format::Vggt) || companions::fps(dir).is_some() {
        return Ok(source);
    }
    let Some(reason) = one_instant::reason(&source.frames) else { return Ok(source) };
    let mut source = read(dir, &Params { static_scene: Some(true), ..params })?;
    source.warnings.push(format!("{reason}: all images are taken as views of one instant (static = true)"));
    Ok(source)
}

impl Frames {
    fn of(source: &SourceCapture) -> Option<Self> {
        let splits = [Split::Train, Split::Val, Split::Test];
        let time = source.time_map;
        let intrinsics = source.frames.first()?.lens.intrinsics;
        Some(Self {
            counts: splits.iter().map(|split| (*split, source.count(*split))).collect(),
            cameras: source.camera_count(),
            training_cameras: source.training_camera_count(),
            intrinsics,
            focal_range_px: focal_range_px(source),
            fov_x_degrees: (2.0 * (0.5 * f64::from(intrinsics.width) / intrinsics.focal_x).atan()).to_degrees(),
            distorted: source.frames.iter().any(|frame| !frame.lens.distortion.is_none()),
            time_range_secs: (!source.is_one_instant()).then_some([time.start_secs, time.end_secs]),
            frame_secs: time.frame_secs,
            masks: source.frames.iter().filter(|frame| frame.mask.is_some()).count(),
            depths: source.frames.iter().filter(|frame| frame.depth.is_some()).count(),
            depth_scale: depth_scale(source),
            bounds_world: source.bounds_world(),
            points: source.points.len(),
            searches_points: source.has_cloud().is_none(),
            quality: source.quality,
        })
    }

    /// Results of estimators in `dir`, if the capture is a real video of one moving camera.
    fn companions(&self, dir: &Path, source: &SourceCapture) -> Companions {
        let formats = [
            Format::Colmap,
            Format::Nerfies,
            Format::Nerfstudio,
            Format::Tum,
            Format::Vggt,
            Format::MegaSam,
            Format::Monst3r,
        ];
        let is_video = formats.contains(&source.format) && self.training_cameras == 1 && self.time_range_secs.is_some();
        let found = if is_video {
            Companions::of_video(dir, self.masks, self.depths, views::has_points_in_view(source))
        } else {
            Companions::default()
        };
        if source.format == Format::Nerfies { found.with_co_visible(dir, self.intrinsics.width) } else { found }
    }

    fn lines(&self) -> Vec<(&'static str, String)> {
        let Intrinsics { width, height, .. } = self.intrinsics;
        let counts = self.counts.iter().filter(|(_, count)| **count > 0);
        let counts: Vec<String> = counts.map(|(split, n)| format!("{n} {}", split.name())).collect();
        let mut lines = vec![
            ("images", format!("{width}×{height}; {}", counts.join(", "))),
            ("cameras", self.cameras_text()),
            ("focal", self.lens_text()),
            ("time", self.time_text()),
        ];
        if self.masks > 0 {
            lines.push(("masks", format!("{}", self.masks)));
        }
        if let Some(quality) = self.quality {
            lines.push(("poses", format!("{} of {} images registered", quality.registered, quality.images)));
        }
        if self.depths > 0 {
            let scale =
                |[unit, median]: [f64; 2]| format!("; {unit} scene units per stored unit, median {}", short(median));
            lines.push(("depth", format!("{} maps{}", self.depths, self.depth_scale.map(scale).unwrap_or_default())));
        }
        lines.push(("points", self.points_text()));
        if let Some([low, high]) = self.bounds_world {
            let side = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f64::max);
            let corner = |corner: [f64; 3]| corner.map(|value| rounded(value, decimals(side, 2.0))).join(", ");
            lines.push(("bounds", format!("({}) to ({})", corner(low), corner(high))));
        }
        lines
    }

    fn lens_text(&self) -> String {
        let Intrinsics { focal_x, focal_y, .. } = self.intrinsics;
        let px = |focal: f64| rounded(focal, decimals(focal, 1.0));
        let focal = if focal_x == focal_y { px(focal_x) } else { format!("{} × {}", px(focal_x), px(focal_y)) };
        let [least, most] = self.focal_range_px.map(px);
        let all = if least == most { String::new() } else { format!(" ({least} to {most} px in all views)") };
        let lens = if self.distorted { "; distorted, undistorted by the import" } else { "" };
        let degrees = rounded(self.fov_x_degrees, decimals(self.fov_x_degrees, 1.0));
        format!("{focal} px{all}, {degrees}° horizontal field of view{lens}")
    }

    fn cameras_text(&self) -> String {
        match (self.time_range_secs, self.cameras) {
            (None, count) => format!("{count} at one instant"),
            (Some(_), 1) => "1, moving (one view per instant)".into(),
            (Some(_), count) if self.training_cameras == 1 => {
                format!("1, moving (one view per instant), and {} for testing", count - 1)
            }
            (Some(_), count) => format!("{count} (a rig)"),
        }
    }

    fn time_text(&self) -> String {
        match self.time_range_secs {
            Some([start, end]) => {
                let text = |secs: f64| rounded(secs, decimals(self.frame_secs, 4.0));
                let start = if start == 0.0 { "0".into() } else { text(start) };
                format!("{start} to {} s, {} s per frame", text(end), text(self.frame_secs))
            }
            None => "one instant".into(),
        }
    }

    fn points_text(&self) -> String {
        let plausible = |quality: Quality| quality.reprojection.filter(ReprojectionError::is_plausible);
        match self.quality.map(plausible) {
            None if self.searches_points => {
                "triangulated by the import, in the training views of the first instant".into()
            }
            None if self.points == 0 => "none (initial points will be random)".into(),
            Some(Some(error)) => format!(
                "{}, mean reprojection error {:.2} px (stored by COLMAP: {:.2} px)",
                self.points, error.recomputed_px, error.stored_px
            ),
            None | Some(None) => self.points.to_string(),
        }
    }
}

/// The unit of the depth maps, and the median of a few of them.
fn depth_scale(source: &SourceCapture) -> Option<[f64; 2]> {
    let medians = depth_scale::medians(source);
    Some([medians.first()?.units_per_value, median(medians.iter().map(|found| found.depth_view))?])
}

/// Least and greatest horizontal focal length.
fn focal_range_px(source: &SourceCapture) -> [f64; 2] {
    let focal_lengths = source.frames.iter().map(|frame| frame.lens.intrinsics.focal_x);
    focal_lengths.fold([f64::INFINITY, 0.0], |[least, most], focal| [least.min(focal), most.max(focal)])
}

/// The number of decimals, at least `least`, that shows two digits of `size`.
fn decimals(size: f64, least: f64) -> usize {
    let needed = if size > 0.0 { 1.0 - size.log10().floor() } else { least };
    needed.clamp(least, MOST_DECIMALS) as usize
}

/// The value with a number of decimals, without the sign of a zero. Very large values have an exponent.
fn rounded(value: f64, decimals: usize) -> String {
    if value.abs() >= LARGE {
        return format!("{value:.2e}");
    }
    let text = format!("{value:.decimals$}");
    let is_zero = text.chars().all(|char| matches!(char, '-' | '0' | '.'));
    if is_zero { text.trim_start_matches('-').into() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_any_size_are_readable() {
        let bounds = |corner: f64, side: f64| rounded(corner, decimals(side, 2.0));
        assert_eq!([bounds(-0.97, 1.94), bounds(-9.7e-5, 1.94e-4), bounds(-0.001, 3.0)], ["-0.97", "-0.00010", "0.00"]);
        let secs = |time: f64, frame: f64| rounded(time, decimals(frame, 4.0));
        assert_eq!([secs(1_700_000_000.000_21, 0.03), secs(2e-6, 1.5e-6)], ["1700000000.0002", "0.0000020"]);
        assert_eq!([rounded(1e30, decimals(1e30, 1.0)), rounded(0.0, decimals(0.0, 2.0))], ["1.00e30", "0.00"]);
    }
}

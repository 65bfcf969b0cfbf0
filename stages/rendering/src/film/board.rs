//! Pictures of the frames of a film: the ground truth and several models side by side, at the same times and cameras.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use image::RgbImage;
use image::imageops;
use scene::{Camera, Capture, View};
use shaders::tape::Device;

use super::shots::{Film, Shot, shots};
use super::subject::Subject;

/// A camera is that of a view if no element of its pose differs by more: the rounding of a path that passes the view.
const SAME_POSE: f64 = 1e-6;

/// The panels of a picture: one per model, from left to right.
#[derive(Clone, Copy, Debug)]
pub struct Panels {
    /// Whether the first panel shows the capture's own images.
    pub truth: bool,
    /// Enlarges every panel by this factor.
    pub scale: u32,
}

/// The models, and the frames that they render.
pub(super) struct Board {
    capture: Capture,
    shots: Vec<Shot>,
    /// Indices of the views that the frames show; empty without ground truth.
    truths: Vec<usize>,
    subjects: Vec<Subject>,
    scale: u32,
}

impl Board {
    /// Opens models of one capture. With [`Panels::truth`], every frame must show a view of the capture: its camera, at most half
    /// a frame from its time.
    pub(super) fn open(
        model_dirs: &[PathBuf],
        capture_dir: &Path,
        film: &Film,
        panels: Panels,
        device: Device,
    ) -> anyhow::Result<Self> {
        let capture = Capture::open(capture_dir)?;
        let shots = shots(film, &capture)?;
        let truths = if panels.truth { truths(&shots, &capture)? } else { Vec::new() };
        let open = |dir: &PathBuf| Subject::open(dir, film.selection.as_ref(), device);
        let subjects = model_dirs.iter().map(open).collect::<anyhow::Result<_>>()?;
        Ok(Self { capture, shots, truths, subjects, scale: panels.scale })
    }

    /// Number of frames; at least one.
    pub(super) fn frames(&self) -> usize {
        self.shots.len()
    }

    /// Number of panels.
    pub(super) fn panels(&self) -> usize {
        self.subjects.len() + usize::from(!self.truths.is_empty())
    }

    /// What the prompt selects in every model, a line each; empty without a prompt.
    pub(super) fn selects(&self) -> String {
        self.subjects.iter().map(|subject| subject.selects.as_str()).collect()
    }

    /// Width and height of the enlarged picture of one frame.
    pub(super) fn size(&self) -> [u64; 2] {
        let intrinsics = &self.shots[0].camera.intrinsics;
        let scale = u64::from(self.scale);
        [u64::from(intrinsics.width) * scale * self.panels() as u64, u64::from(intrinsics.height) * scale]
    }

    /// The panels of a frame, at their own size.
    fn images(&self, frame: usize) -> impl Iterator<Item = anyhow::Result<RgbImage>> {
        let truth = self.truths.get(frame).map(|view| Ok(self.capture.load_image(&self.capture.views[*view])?));
        let shot = &self.shots[frame];
        truth.into_iter().chain(self.subjects.iter().map(move |subject| subject.image(shot)))
    }

    /// The panels of a frame from left to right, not enlarged.
    pub(super) fn picture(&self, frame: usize) -> anyhow::Result<RgbImage> {
        let [width, height] = self.size().map(|length| length as u32 / self.scale);
        let mut picture = RgbImage::new(width, height);
        let mut left = 0;
        for image in self.images(frame) {
            let image = image?;
            imageops::replace(&mut picture, &image, left, 0);
            left += i64::from(image.width());
        }
        Ok(picture)
    }
}

/// The view that each frame shows, as an index within the capture.
fn truths(shots: &[Shot], capture: &Capture) -> anyhow::Result<Vec<usize>> {
    let off_secs = |view: &View, shot: &Shot| (view.time_secs - shot.time_secs).abs();
    let truth = |(index, shot): (usize, &Shot)| {
        let views = capture.views.iter().enumerate();
        let of_camera = views.filter(|(_, view)| is_same(&view.camera, &shot.camera));
        let nearest = of_camera.min_by(|(_, a), (_, b)| off_secs(a, shot).total_cmp(&off_secs(b, shot)));
        let shown = nearest.filter(|(_, view)| off_secs(view, shot) <= 0.5 * capture.time_map.frame_secs);
        shown.map(|(at, _)| at).ok_or_else(|| {
            let message =
                format!("no view of the capture shows frame {index}: its camera took none at {} s", shot.time_secs);
            let hint = "let the film follow views of the capture (--views test without --times), or omit --truth";
            Failure::new(FailureKind::BadInput, message).hint(hint).at(&capture.dir).into()
        })
    };
    shots.iter().enumerate().map(truth).collect()
}

/// Whether two cameras take the same image, up to rounding.
fn is_same(a: &Camera, b: &Camera) -> bool {
    let (pose_a, pose_b) = (a.camera_from_world, b.camera_from_world);
    a.intrinsics == b.intrinsics
        && pose_a.rotation.abs_diff_eq(pose_b.rotation, SAME_POSE)
        && pose_a.translation.abs_diff_eq(pose_b.translation, SAME_POSE * (1.0 + pose_a.translation.length()))
}

/// Refuses a file that cannot be written before time is spent on rendering. An existing file keeps its content.
pub(super) fn check_place(file: &Path) -> anyhow::Result<()> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let (problem, path) = match () {
        () if file.is_dir() => ("the picture would replace a folder", file),
        () if !folder.is_dir() => ("the folder of the picture does not exist", folder),
        () => return try_to_open(file),
    };
    Err(Failure::new(FailureKind::BadInput, problem).hint("name a file in an existing folder").at(path).into())
}

/// Opens a file for writing, and removes it again if it is new.
fn try_to_open(file: &Path) -> anyhow::Result<()> {
    let is_new = file.symlink_metadata().is_err();
    let cannot = |error| {
        let message = format!("the picture cannot be written ({error})");
        Failure::new(FailureKind::World, message).hint("name another file").at(file)
    };
    std::fs::OpenOptions::new().append(true).create(true).open(file).map_err(cannot)?;
    if is_new {
        std::fs::remove_file(file).map_err(cannot)?;
    }
    Ok(())
}

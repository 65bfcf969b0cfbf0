//! NVIDIA's Dynamic Scenes (Yoon et al. 2020) as NSFF (Li et al. 2021) prepares them: a camera that jumps along a rig of
//! twelve, one frame of `images` and one row of `poses_bounds.npy` per instant, and the views of all twelve cameras in
//! `mv_images/INSTANT/camNN.jpg`.
//!
//! Frame t is from camera t mod 12. The test views are those of the other eleven cameras at the same instant, with the
//! poses of the first twelve rows, as in the evaluation of NSFF.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::Split;

use crate::error::{Result, bad};
use crate::files::image_size;
use crate::image_names::image_named;
use crate::lens::Lens;
use crate::llff::{by_instant, photos};
use crate::params::{Format, Params};
use crate::poses_bounds::{self, Stated};
use crate::rig;
use crate::source::{Frame, SourceCapture};

/// The folder of test views.
const VIEWS: &str = "mv_images";
/// Cameras of the rig.
const CAMERAS: usize = 12;

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    dir.join(poses_bounds::FILE).is_file() && dir.join(VIEWS).is_dir()
}

/// Reads the poses and the names of the frames; opens only the headers of images.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut warnings = Vec::new();
    let (images, stated, reduction) = photos(dir, params, &mut warnings)?;
    let (images, stated) = by_instant(images, stated);
    if images.len() < CAMERAS {
        let message =
            format!("{} frames of a rig of {CAMERAS} cameras: the poses of some cameras are missing", images.len());
        return Err(bad(message).hint("download all frames of the scene").at(dir.join("images")));
    }
    let source = Source { dir, stated: &stated, reduction, params };
    let mut frames = Vec::new();
    for (instant, image) in images.into_iter().enumerate() {
        frames.push(source.frame(Split::Train, instant, instant % CAMERAS, instant, image));
        let others = (0..CAMERAS).filter(|camera| *camera != instant % CAMERAS);
        for camera in others {
            frames.push(source.frame(Split::Test, instant, camera, camera, source.view(instant, camera)?));
        }
    }
    source.check_size(&frames)?;
    let mut rules = vec!["the other cameras of each instant held out".to_owned(), format!("{} frames", stated.len())];
    if reduction > 1 {
        rules.push(format!("images at 1/{reduction}"));
    }
    let capture = rig::capture(dir, (Format::Nvidia, "nvidia-dynamic"), frames, rules, params);
    Ok(SourceCapture { wants_test: true, warnings, ..capture })
}

struct Source<'a> {
    dir: &'a Path,
    stated: &'a [Stated],
    reduction: u32,
    params: &'a Params,
}

impl Source<'_> {
    /// The view of `camera` at `instant`, with the pose of `row`.
    fn frame(&self, split: Split, instant: usize, camera: usize, row: usize, image: PathBuf) -> Frame {
        let stated = poses_bounds::reduced(&self.stated[row].camera, self.reduction);
        Frame {
            name: format!("cam{:02}_{instant:04}", camera + 1),
            split,
            image,
            stored_image: None,
            mask: None,
            depth: None,
            lens: Lens::pinhole(stated.intrinsics),
            camera_from_world: stated.camera_from_world,
            camera_index: camera as u32,
            frame_index: instant as u32,
            time_secs: instant as f64 / self.params.fps,
            stated_in: self.dir.join(poses_bounds::FILE),
        }
    }

    /// The file of a test view.
    fn view(&self, instant: usize, camera: usize) -> Result<PathBuf> {
        let (folder, name) = (self.dir.join(VIEWS).join(format!("{instant:05}")), format!("cam{:02}", camera + 1));
        image_named(&folder, &name).ok_or_else(|| {
            let failure = Failure::new(FailureKind::MissingData, "the test view is missing");
            failure
                .hint("download the scene again: each of mv_images/00000, 00001, … has cam01 to cam12")
                .at(folder.join(name))
        })
    }

    /// Refuses training images of another size than the test views.
    fn check_size(&self, frames: &[Frame]) -> Result<()> {
        let size_of = |split| frames.iter().find(|frame| frame.split == split).map(|frame| image_size(&frame.image));
        let (Some(train), Some(test)) = (size_of(Split::Train), size_of(Split::Test)) else { return Ok(()) };
        let (train, test) = (train?, test?);
        if train == test {
            return Ok(());
        }
        let message = format!("training images of {}×{}, but test views of {}×{}", train.0, train.1, test.0, test.1);
        let hint = "set images to the folder of images with the size of mv_images, e.g. images = \"images_512x288\"";
        Err(bad(message).hint(hint).at(self.dir))
    }
}

//! Scenes of ScanNet (Dai et al. 2017) as its `SensReader` exports them: `color/N.jpg`, `depth/N.png` in millimetres,
//! `pose/N.txt` (a 4×4 matrix from camera to world, OpenCV's axes, `-inf` where tracking was lost) and
//! `intrinsic/intrinsic_{color,depth}.txt` (4×4 matrices).
//!
//! N is the number of a frame of the recording. Depth maps are smaller than images and have another lens at the same place.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::{Intrinsics, RigidTransform};

use crate::depth::DepthFile;
use crate::depth_video::{self, frame, from_opencv, skipped_notice};
use crate::error::{Result, bad};
use crate::files::{self, image_size, read_text};
use crate::lens::Lens;
use crate::matrices::{pinhole, straightened, transform};
use crate::number_lines::{Line, lines};
use crate::params::{Format, Params};
use crate::rig::{self, videos};
use crate::source::{Frame, SourceCapture};

/// The folder of images.
const IMAGES: &str = "color";
/// The folder of poses.
const POSES: &str = "pose";
/// The folder of lenses.
pub(crate) const LENSES: &str = "intrinsic";
/// The lens of the images.
const IMAGE_LENS: &str = "intrinsic_color.txt";
/// The lens of the depth maps.
const DEPTH_LENS: &str = "intrinsic_depth.txt";
/// The command that writes all of these files.
const EXPORT: &str = "export the scene again with SensReader's reader.py: --export_color_images --export_depth_images \
                      --export_poses --export_intrinsics";

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    [IMAGES, POSES].iter().all(|name| dir.join(name).is_dir())
}

/// Reads the poses and the names of the images; opens only the headers of images.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let images = videos::images(&dir.join(IMAGES));
    let Some(first) = images.first() else {
        let failure = Failure::new(FailureKind::MissingData, "the folder has no images");
        return Err(failure.hint(EXPORT).at(dir.join(IMAGES)));
    };
    let lens = Lens::pinhole(lens(dir, IMAGE_LENS, image_size(first)?)?);
    let first_number = videos::number(first)?;
    let depth = DepthMaps::of(dir, &images, params)?;
    let (mut frames, mut skipped) = (Vec::new(), Vec::new());
    for image in &images {
        let stem = image.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let stated_in = dir.join(POSES).join(format!("{stem}.txt"));
        let Some(pose) = pose(&stated_in)? else {
            skipped.push(files::name(image));
            continue;
        };
        let index = videos::number(image)?.checked_sub(first_number).and_then(|index| u32::try_from(index).ok());
        let index = index.ok_or_else(|| bad("the number of the frame is out of order").hint(EXPORT).at(image))?;
        let instant = (index, f64::from(index) / params.fps);
        let depth = depth.as_ref().and_then(|depth| depth.of_frame(&stem));
        frames.push(Frame { depth, ..frame(image.clone(), lens, &pose, instant, &stated_in) });
    }
    if frames.is_empty() {
        let message = format!("tracking was lost in all {} images: no pose is finite", images.len());
        return Err(bad(message).hint("use another scene").at(dir.join(POSES)));
    }
    let warnings = skipped_notice(&skipped, images.len(), "tracking was lost, and their pose is not finite");
    let warnings = warnings.into_iter().collect();
    Ok(depth_video::capture(dir, (Format::ScanNet, "scannet"), frames, warnings, params))
}

/// The depth maps of a scene.
struct DepthMaps {
    folder: PathBuf,
    /// Scene units per stored unit.
    unit: Option<f64>,
    /// Their pinhole; if `None`, that of the images.
    pinhole: Option<Intrinsics>,
}

impl DepthMaps {
    /// The maps of these images; `None` if no image has one.
    fn of(dir: &Path, images: &[PathBuf], params: &Params) -> Result<Option<Self>> {
        let maps = Self { folder: dir.join("depth"), unit: params.depth_unit, pinhole: None };
        let stem = |image: &PathBuf| image.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let Some(first) = images.iter().find_map(|image| maps.of_frame(&stem(image))) else { return Ok(None) };
        let has_lens = dir.join(LENSES).join(DEPTH_LENS).is_file();
        let pinhole = has_lens.then(|| lens(dir, DEPTH_LENS, image_size(&first.path)?)).transpose()?;
        Ok(Some(Self { pinhole, ..maps }))
    }

    fn of_frame(&self, stem: &str) -> Option<DepthFile> {
        let path = self.folder.join(format!("{stem}.png"));
        path.is_file().then(|| DepthFile::new(path, self.unit).with_pinhole(self.pinhole))
    }
}

/// The pinhole in one of the two files, for images of this size.
fn lens(dir: &Path, name: &str, size: (u32, u32)) -> Result<Intrinsics> {
    let path = dir.join(LENSES).join(name);
    let rows = matrix(&path)?;
    let blame = |failure: Failure| failure.at(&path);
    if rows.iter().any(|value| !value.is_finite()) {
        return Err(blame(bad("the matrix is not finite").hint(EXPORT)));
    }
    let [focal_x, skew, center_x, _, _, focal_y, center_y, ..] = rows;
    if skew != 0.0 {
        return Err(blame(bad(format!("a skew of {skew} px is not supported"))));
    }
    let stated = pinhole(&[focal_x, skew, center_x, 0.0, focal_y, center_y], size);
    rig::check_size(name, &stated).map_err(blame)?;
    Ok(from_opencv(stated))
}

/// The pose in a file, from camera to world; `None` where tracking was lost.
fn pose(path: &Path) -> Result<Option<RigidTransform>> {
    let rows = matrix(path)?;
    if rows.iter().any(|value| !value.is_finite()) {
        return Ok(None);
    }
    if rows[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err(bad("the last row of the pose is not 0 0 0 1").hint(EXPORT).at(path));
    }
    Ok(Some(straightened(transform(&rows))))
}

/// The rows of a 4×4 matrix, which may be infinite or NaN.
fn matrix(path: &Path) -> Result<[f64; 16]> {
    let blame = |failure: Failure| failure.hint(EXPORT).at(path);
    let text = read_text(path).map_err(blame)?;
    let row = |line: Line<'_>| {
        let message = format!("line {}: 4 numbers are expected", line.number);
        line.numbers::<4>().ok_or_else(|| blame(bad(message)))
    };
    let rows = lines(&text).map(row).collect::<Result<Vec<_>>>()?;
    let count = rows.len();
    let wrong = || blame(bad(format!("the file has {count} rows of numbers instead of the 4 of a matrix")));
    rows.into_flattened().try_into().map_err(|_| wrong())
}

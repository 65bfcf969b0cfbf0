//! The cameras of published sequences, and of sequences with a `calibration.txt`.

use std::path::Path;

use glam::{DMat3, DMat4, DVec3};
use scene::{Intrinsics, RigidTransform};

use super::IMAGES;
use crate::depth_video::from_opencv;
use crate::error::{Result, bad};
use crate::files::{self, image_size, read_text};
use crate::lens::{Distortion, Lens};
use crate::matrices::{straightened, transform};
use crate::number_lines::lines;
use crate::rig;

/// The file that states the lens of the images, as in the SLAM benchmark of ETH3D.
pub(super) const CALIBRATION: &str = "calibration.txt";
/// Its numbers, in OpenCV's order.
const COLUMNS: &str = "fx fy cx cy [k1 k2 p1 p2 [k3]]";
/// Size of the images of the published sequences.
const SIZE: (u32, u32) = (640, 480);
/// Stored units of depth per metre.
const PER_METRE: f64 = 5000.0;

/// A part of a folder's name, the data set, and the lens as on the data set's page: [`COLUMNS`].
type Published = (&'static str, &'static str, [f64; 9]);

/// Images of freiburg3 are already undistorted.
const PUBLISHED: [Published; 4] = [
    ("freiburg1", "tum-rgbd", [517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633]),
    ("freiburg2", "tum-rgbd", [520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172]),
    ("freiburg3", "tum-rgbd", [535.4, 539.2, 320.1, 247.6, 0.0, 0.0, 0.0, 0.0, 0.0]),
    (
        BONN,
        "bonn-rgbd",
        [542.822841, 542.576870, 315.593520, 237.756098, 0.039903, -0.099343, -0.000730, -0.000144, 0.0],
    ),
];

/// Sequences of the RGB-D Dynamic Dataset of Bonn are called `rgbd_bonn_NAME`.
const BONN: &str = "rgbd_bonn";
/// Bonn: the rotation between the world of the motion capture system and that of the laser scan, which is its own inverse.
const SCAN_FROM_CAPTURE: DMat3 = DMat3::from_cols(DVec3::new(-1.0, 0.0, 0.0), DVec3::Z, DVec3::Y);
/// Bonn: from the camera to the markers whose poses are stated, as on the data set's page: the rows of a rotation times a
/// scale, and a translation in metres.
const MARKERS_FROM_CAMERA: [f64; 12] =
    [1.0157, 0.1828, -0.2389, 0.0113, 0.0009, -0.8431, -0.6413, -0.0098, -0.3009, 0.6147, -0.8085, 0.0111];

/// A colour camera with the depth that is registered to it.
pub(super) struct Sensor {
    /// The lens of the images.
    pub(super) lens: Lens,
    /// The data set, for the protocol.
    pub(super) dataset: &'static str,
    /// Whether the poses are those of Bonn's markers instead of the camera.
    is_bonn: bool,
}

impl Sensor {
    /// The sensor of the sequence in `dir`, by `calibration.txt`, or else by the name of the folder.
    pub(super) fn of(dir: &Path, first_image: &Path) -> Result<Self> {
        let name = files::name(dir).to_lowercase();
        let published = PUBLISHED.iter().find(|(part, ..)| name.contains(part));
        let path = dir.join(CALIBRATION);
        let lens = match published {
            _ if path.is_file() => stated(&path, image_size(first_image)?).map_err(|failure| failure.at(&path))?,
            Some((.., numbers)) => lens(numbers, SIZE),
            None => return Err(unknown_lens(dir)),
        };
        let is_bonn = published.is_some_and(|(part, ..)| *part == BONN);
        Ok(Self { lens, dataset: published.map_or("tum", |(_, dataset, _)| dataset), is_bonn })
    }

    /// Metres per stored unit of depth. The transform that Bonn publishes has a scale of 1.059, by which the camera's depth
    /// must be multiplied to agree with the stated motion and the laser scan.
    pub(super) fn metres_per_value(&self) -> f64 {
        let scale = if self.is_bonn { transform(&MARKERS_FROM_CAMERA).rotation.determinant().cbrt() } else { 1.0 };
        scale / PER_METRE
    }

    /// The pose of the camera from a stated pose.
    pub(super) fn world_from_camera(&self, stated: RigidTransform) -> RigidTransform {
        if !self.is_bonn {
            return stated;
        }
        let published = transform(&MARKERS_FROM_CAMERA);
        let unscaled = published.rotation * published.rotation.determinant().cbrt().recip();
        let markers_from_camera = straightened(RigidTransform { rotation: unscaled, ..published });
        let matrix = |it: RigidTransform| DMat4::from_mat3_translation(it.rotation, it.translation);
        let scan_from_capture = DMat4::from_mat3(SCAN_FROM_CAPTURE);
        let mounted = scan_from_capture * matrix(markers_from_camera);
        RigidTransform::from_matrix(scan_from_capture * matrix(stated) * mounted)
    }
}

/// The lens of these [`COLUMNS`].
fn lens(&[focal_x, focal_y, center_x, center_y, k1, k2, p1, p2, k3]: &[f64; 9], (width, height): (u32, u32)) -> Lens {
    let stated = Intrinsics { width, height, focal_x, focal_y, center_x, center_y };
    Lens { intrinsics: from_opencv(stated), distortion: Distortion::brown([k1, k2, k3, 0.0], [p1, p2]) }
}

/// The lens in the first line of a calibration, for images of this size.
fn stated(path: &Path, size: (u32, u32)) -> Result<Lens> {
    let text = read_text(path)?;
    let hint = format!("write one line: {COLUMNS}, in pixels of these images");
    let mut line = lines(&text).next().ok_or_else(|| bad("the file has no numbers").hint(hint.clone()))?;
    let is_complete = [4, 8, 9].contains(&line.words.len());
    line.words.resize(if is_complete { 9 } else { 0 }, "0");
    let message = format!("line {}: 4, 8 or 9 finite numbers are expected ({COLUMNS})", line.number);
    let numbers = line.finite("").map_err(|_| bad(message).hint(hint))?;
    let lens = lens(&numbers, size);
    rig::check_size("the images", &lens.intrinsics)?;
    Ok(lens)
}

/// The error for a sequence whose lens neither a file nor the folder's name states.
fn unknown_lens(dir: &Path) -> engine::Failure {
    let names = PUBLISHED.map(|(part, ..)| part).join(", ");
    let message = format!("the lens is unknown: there is no {CALIBRATION}, and the folder's name has none of {names}");
    let hint = format!(
        "write {CALIBRATION} next to {IMAGES} with one line, {COLUMNS}: focal lengths and principal point in pixels, and \
         OpenCV's distortion, e.g. `525 525 319.5 239.5` for a Kinect that was not calibrated"
    );
    bad(message).hint(hint).at(dir)
}

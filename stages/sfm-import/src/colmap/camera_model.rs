//! COLMAP's camera models as lenses.

use engine::{Failure, FailureKind};
use scene::Intrinsics;

use crate::error::{Result, bad};
use crate::lens::{Distortion, Lens};

/// Names and parameter counts of COLMAP's camera models; the index is the model number in binary files.
pub(crate) const CAMERA_MODELS: [(&str, usize); 17] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
];
/// The models that are not implemented: the first applies its distortions in another order, the others need an inversion.
const UNSUPPORTED: [&str; 4] = ["RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "EUCM"];

/// The lens of a camera model and its parameters: focal lengths, principal point, distortion.
pub(crate) fn lens(model: &str, width: u64, height: u64, params: &[f64]) -> Result<Lens> {
    let known = CAMERA_MODELS.iter().find(|(name, _)| *name == model);
    let Some((_, count)) = known.filter(|(name, _)| !UNSUPPORTED.contains(name)) else {
        return Err(unsupported(model, known.is_some()));
    };
    if params.len() != *count {
        return Err(bad(format!("camera model {model} does not have {} parameters", params.len())));
    }
    if let Some(value) = params.iter().find(|value| !value.is_finite()) {
        return Err(bad(format!("a camera parameter is {value}")));
    }
    let has_one_focal = model.starts_with("SIMPLE") || model.starts_with("RADIAL");
    let (focal_y, rest) = if has_one_focal { (params[0], &params[1..]) } else { (params[1], &params[2..]) };
    let size = |pixels: u64| {
        u32::try_from(pixels).map_err(|_| bad(format!("an image size of {width}×{height} pixels is too large")))
    };
    let intrinsics = Intrinsics {
        width: size(width)?,
        height: size(height)?,
        focal_x: params[0],
        focal_y,
        center_x: rest[0],
        center_y: rest[1],
    };
    Ok(Lens { intrinsics, distortion: distortion(model, &rest[2..]) })
}

/// The distortion of a supported model with the right number of parameters.
fn distortion(model: &str, params: &[f64]) -> Distortion {
    let none = [0.0; 2];
    match *params {
        [] if model.ends_with("FISHEYE") => Distortion::fisheye([0.0; 4]),
        [omega] if model == "FOV" => Distortion::field_of_view(omega),
        [k1] if model == "SIMPLE_RADIAL_FISHEYE" => Distortion::fisheye([k1, 0.0, 0.0, 0.0]),
        [k1] => Distortion::brown([k1, 0.0, 0.0, 0.0], none),
        [k1, k2] if model == "RADIAL_FISHEYE" => Distortion::fisheye([k1, k2, 0.0, 0.0]),
        [k1, k2] => Distortion::brown([k1, k2, 0.0, 0.0], none),
        [k1, k2, k3, k4] if model == "OPENCV_FISHEYE" => Distortion::fisheye([k1, k2, k3, k4]),
        [k1, k2, p1, p2] => Distortion::brown([k1, k2, 0.0, 0.0], [p1, p2]),
        [k1, k2, p1, p2, k3, k4, sx1, sy1] if model == "THIN_PRISM_FISHEYE" => {
            Distortion::thin_prism_fisheye([k1, k2, k3, k4], [p1, p2], [sx1, sy1])
        }
        [k1, k2, p1, p2, k3, k4, k5, k6] => Distortion::rational([k1, k2, k3], [k4, k5, k6], [p1, p2]),
        _ => Distortion::default(),
    }
}

fn unsupported(model: &str, is_known: bool) -> Failure {
    let what = if is_known { "not supported" } else { "unknown" };
    let supported = CAMERA_MODELS.map(|(name, _)| name).into_iter().filter(|name| !UNSUPPORTED.contains(name));
    let supported = supported.collect::<Vec<_>>().join(", ");
    let hint = format!("run `colmap image_undistorter`; supported: {supported}");
    Failure::new(FailureKind::BadInput, format!("camera model {model} is {what}")).hint(hint)
}

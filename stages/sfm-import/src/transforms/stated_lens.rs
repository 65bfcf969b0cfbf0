//! The lens in transforms files, stated per file or per frame: `camera_angle_x` of NeRF and the keys that instant-ngp and
//! nerfstudio add.

use scene::Intrinsics;
use serde::Deserialize;

use crate::error::{Result, bad};
use crate::lens::{Distortion, Lens};

/// COLMAP's names of the perspective camera models that these files use, and nerfstudio's.
const PERSPECTIVE: [&str; 6] = ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PERSPECTIVE"];
/// nerfstudio's name of panoramas.
const PANORAMA: &str = "EQUIRECTANGULAR";
/// The keys of numbers, for errors.
pub(super) const NUMBERS: [&str; 16] = [
    "camera_angle_x",
    "camera_angle_y",
    "fl_x",
    "fl_y",
    "fx",
    "fy",
    "cx",
    "cy",
    "w",
    "h",
    "k1",
    "k2",
    "k3",
    "k4",
    "p1",
    "p2",
];
/// The name of the fisheye model.
const FISHEYE: &str = "OPENCV_FISHEYE";
/// Relative difference of a focal length from its field of view that is due to rounding.
const SAME_FOCAL: f64 = 0.01;
/// Ratio of a focal length and its field of view beyond which one of them is wrong.
const CONTRADICTION: f64 = 1.25;

/// The lens keys of a file or a frame; those of a frame take precedence. Lengths are in pixels, angles in radians.
#[derive(Clone, Debug, Default, Deserialize)]
pub(super) struct StatedLens {
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    /// Dense depth priors: the same as `fl_x` and `fl_y`.
    fx: Option<f64>,
    fy: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

impl StatedLens {
    /// Fills the keys that a frame omits from its file. A horizontal focal length of the frame also replaces the file's
    /// vertical one.
    pub(super) fn or(&self, file: &Self) -> Self {
        let states_x = self.fl_x.or(self.fx).or(self.camera_angle_x).is_some();
        let states_y = self.fl_y.or(self.fy).or(self.camera_angle_y).is_some();
        let [of_x, of_y] = [states_x, states_x || states_y].map(|stated| if stated { self } else { file });
        Self {
            camera_model: self.camera_model.clone().or_else(|| file.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(file.is_fisheye),
            camera_angle_x: of_x.camera_angle_x,
            camera_angle_y: of_y.camera_angle_y,
            fl_x: of_x.fl_x.or(of_x.fx),
            fl_y: of_y.fl_y.or(of_y.fy),
            fx: None,
            fy: None,
            cx: self.cx.or(file.cx),
            cy: self.cy.or(file.cy),
            w: self.w.or(file.w),
            h: self.h.or(file.h),
            k1: self.k1.or(file.k1),
            k2: self.k2.or(file.k2),
            k3: self.k3.or(file.k3),
            k4: self.k4.or(file.k4),
            p1: self.p1.or(file.p1),
            p2: self.p2.or(file.p2),
        }
    }

    /// The lens for images of the stated size, or of the size `found` in the image file. Defaults: a focal length of
    /// width / (2 tan(angle / 2)), or the same of the height, square pixels, and the principal point at the image centre.
    pub(super) fn lens(&self, found: (u32, u32)) -> Result<Lens> {
        let (width, height) = (pixels("w", self.w, found.0)?, pixels("h", self.h, found.1)?);
        let focal_x = focal(["fl_x", "camera_angle_x"], self.fl_x, self.camera_angle_x, width)?;
        let focal_y = focal(["fl_y", "camera_angle_y"], self.fl_y, self.camera_angle_y, height)?;
        let Some((focal_x, focal_y)) = focal_x.or(focal_y).zip(focal_y.or(focal_x)) else {
            let hint = "state the horizontal field of view (camera_angle_x, radians; x_fov of instant-ngp is in degrees) or the focal \
                        length (fl_x, pixels)";
            return Err(bad("neither fl_x nor camera_angle_x is stated").hint(hint));
        };
        let center_x = self.cx.unwrap_or(0.5 * f64::from(width));
        let center_y = self.cy.unwrap_or(0.5 * f64::from(height));
        let intrinsics = Intrinsics { width, height, focal_x, focal_y, center_x, center_y };
        Ok(Lens { intrinsics, distortion: self.distortion()? })
    }

    /// A warning about focal lengths that disagree with the fields of view; the focal lengths are used. Otherwise, one about a lens
    /// that is stated in one direction only, and not in the usual one.
    pub(super) fn warning(&self, used: &Intrinsics) -> Option<String> {
        if self.fl_x.or(self.camera_angle_x).is_none() {
            let key = if self.fl_y.is_some() { "fl_y" } else { "camera_angle_y" };
            return Some(format!("only {key} states the lens: pixels are taken as square; state fl_x if they are not"));
        }
        let sides = [
            ("fl_x", self.fl_x, "camera_angle_x", self.camera_angle_x, used.width),
            ("fl_y", self.fl_y, "camera_angle_y", self.camera_angle_y, used.height),
        ];
        sides.into_iter().find_map(|(key, focal, angle_key, angle, length)| {
            let (focal, implied) = (focal?, focal_of_angle(angle?, length));
            let differs = !((focal / implied - 1.0).abs() <= SAME_FOCAL);
            differs.then(|| format!("{key} is {focal:.1} px, but {angle_key} implies {implied:.1} px: {key} is used"))
        })
    }

    /// The distortion of the camera model: perspective if none is stated.
    fn distortion(&self) -> Result<Distortion> {
        let hint = "undistort the images first, e.g. with `colmap image_undistorter`";
        let radial = [self.k1, self.k2, self.k3, self.k4].map(Option::unwrap_or_default);
        let tangential = [self.p1, self.p2].map(Option::unwrap_or_default);
        let model = self.camera_model.as_deref().map(str::to_uppercase);
        match model.as_deref() {
            Some(PANORAMA) => {
                let hint = "cut the panoramas into perspective views and estimate their poses, e.g. with `ns-process-data \
                            images --camera-type equirectangular` of nerfstudio";
                Err(bad(format!("camera model {PANORAMA} is not supported")).hint(hint))
            }
            Some(FISHEYE) => Ok(Distortion::fisheye(radial)),
            None if self.is_fisheye == Some(true) => Ok(Distortion::fisheye(radial)),
            Some(model) if !PERSPECTIVE.contains(&model) => {
                let supported = PERSPECTIVE.join(", ");
                let message = format!("camera model {model} is not supported (one of {supported}, {FISHEYE})");
                Err(bad(message).hint(hint))
            }
            // OpenCV divides by 1 + k4 r², Brown's model adds k4 r⁸, and writers mean either.
            _ if radial[3] != 0.0 => {
                let message = format!("k4 is {}, which has no agreed meaning for a perspective lens", radial[3]);
                Err(bad(message).hint(hint))
            }
            _ => Ok(Distortion::brown(radial, tangential)),
        }
    }
}

/// An image side in pixels, which files may write as 800.0; `found` if the key is missing.
fn pixels(key: &str, stated: Option<f64>, found: u32) -> Result<u32> {
    match stated {
        None => Ok(found),
        Some(value) if value >= 1.0 && value <= f64::from(u32::MAX) && value.fract() == 0.0 => Ok(value as u32),
        Some(value) => Err(bad(format!("{key} is {value}, but must be a whole number of pixels"))),
    }
}

/// The focal length in pixels, from the key itself or from a field of view over `length` pixels. Keys that contradict each
/// other are an error: one of them belongs to other images or has another unit.
fn focal(keys: [&str; 2], stated: Option<f64>, angle: Option<f64>, length: u32) -> Result<Option<f64>> {
    if let Some(angle) = angle.filter(|angle| !(*angle > 0.0 && *angle < std::f64::consts::PI)) {
        return Err(bad(format!("{} is {angle}, but must be between 0 and π radians", keys[1])));
    }
    let implied = angle.map(|angle| focal_of_angle(angle, length));
    match (stated, implied) {
        (Some(focal), _) if !(focal > 0.0 && focal.is_finite()) => {
            Err(bad(format!("{} is {focal}, but a focal length must be positive", keys[0])))
        }
        (Some(focal), Some(implied)) if !((focal / implied).ln().abs() <= CONTRADICTION.ln()) => {
            let message = format!("{} is {focal} pixels, but {} implies {implied:.1}", keys[0], keys[1]);
            Err(bad(message)
                .hint("remove the wrong key; is the focal length in millimetres, or of another image size?"))
        }
        (stated, implied) => Ok(stated.or(implied)),
    }
}

fn focal_of_angle(angle: f64, length: u32) -> f64 {
    0.5 * f64::from(length) / (0.5 * angle).tan()
}

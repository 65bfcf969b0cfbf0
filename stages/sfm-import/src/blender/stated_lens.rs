//! What transforms files say of the lens, once for all frames or frame by frame: `camera_angle_x` in the files of NeRF, and
//! the keys that instant-ngp and nerfstudio add.

use scene::Intrinsics;
use serde::Deserialize;

use crate::lens::{Distortion, Lens};
use crate::source::{Result, bad};

/// Camera models (of COLMAP, by name) that the coefficients here describe.
const MODELS: [&str; 5] = ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"];

/// The keys of one file, or of one frame, which count before those of its file. Lengths are in pixels, angles in radians.
#[derive(Clone, Debug, Default, Deserialize)]
pub struct StatedLens {
    camera_model: Option<String>,
    #[serde(default)]
    is_fisheye: bool,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
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
    /// What a frame states, and what its file states beyond that. A frame's horizontal focal length is also its vertical one
    /// where it states no other.
    pub fn or(&self, file: &Self) -> Self {
        let states_x = self.fl_x.or(self.camera_angle_x).is_some();
        let states_y = self.fl_y.or(self.camera_angle_y).is_some();
        let [of_x, of_y] = [states_x, states_x || states_y].map(|stated| if stated { self } else { file });
        Self {
            camera_model: self.camera_model.clone().or_else(|| file.camera_model.clone()),
            is_fisheye: self.is_fisheye || file.is_fisheye,
            camera_angle_x: of_x.camera_angle_x,
            camera_angle_y: of_y.camera_angle_y,
            fl_x: of_x.fl_x,
            fl_y: of_y.fl_y,
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

    /// The lens of images whose size is stated, or is `found`. Unstated focal lengths are width / (2 tan(angle / 2)), pixels
    /// are square and the principal point is the image's centre.
    pub fn lens(&self, found: (u32, u32)) -> Result<Lens> {
        self.refuse_other_models()?;
        let (width, height) = (pixels("w", self.w, found.0)?, pixels("h", self.h, found.1)?);
        let Some(focal_x) = focal(["fl_x", "camera_angle_x"], self.fl_x, self.camera_angle_x, width)? else {
            return Err(bad("neither fl_x nor camera_angle_x says how wide the camera sees"));
        };
        let focal_y = focal(["fl_y", "camera_angle_y"], self.fl_y, self.camera_angle_y, height)?.unwrap_or(focal_x);
        let center_x = self.cx.unwrap_or(0.5 * f64::from(width));
        let center_y = self.cy.unwrap_or(0.5 * f64::from(height));
        let [k1, k2, k3, p1, p2] = [self.k1, self.k2, self.k3, self.p1, self.p2].map(Option::unwrap_or_default);
        let intrinsics = Intrinsics { width, height, focal_x, focal_y, center_x, center_y };
        Ok(Lens { intrinsics, distortion: Distortion { k1, k2, k3, p1, p2 } })
    }

    fn refuse_other_models(&self) -> Result<()> {
        let hint = "undistort the images first, as with `colmap image_undistorter`";
        let other = self.camera_model.as_deref().filter(|model| !MODELS.contains(model));
        if let Some(model) = other.or(self.is_fisheye.then_some("is_fisheye")) {
            let message = format!("camera model {model} is not supported (one of {})", MODELS.join(", "));
            return Err(bad(message).hint(hint));
        }
        match self.k4 {
            Some(k4) if k4 != 0.0 => Err(bad(format!("k4 is {k4}: lens distortion of r⁸ is not supported")).hint(hint)),
            _ => Ok(()),
        }
    }
}

/// A number of pixels that files may write as 800.0.
fn pixels(key: &str, stated: Option<f64>, found: u32) -> Result<u32> {
    match stated {
        None => Ok(found),
        Some(value) if value >= 1.0 && value <= f64::from(u32::MAX) && value.fract() == 0.0 => Ok(value as u32),
        Some(value) => Err(bad(format!("{key} is {value}, not a number of pixels"))),
    }
}

/// The stated focal length, or that of the stated angle over `length` pixels.
fn focal(keys: [&str; 2], stated: Option<f64>, angle: Option<f64>, length: u32) -> Result<Option<f64>> {
    match (stated, angle) {
        (Some(focal), _) if focal > 0.0 && focal.is_finite() => Ok(Some(focal)),
        (Some(focal), _) => Err(bad(format!("{} is {focal}, not a focal length in pixels", keys[0]))),
        (None, Some(angle)) if angle > 0.0 && angle < std::f64::consts::PI => {
            Ok(Some(0.5 * f64::from(length) / (0.5 * angle).tan()))
        }
        (None, Some(angle)) => Err(bad(format!("{} is {angle}, not an angle between 0 and π radians", keys[1]))),
        (None, None) => Ok(None),
    }
}

//! Small captures in the layouts of public data sets: a textured ball before a textured wall, seen by a rig of known
//! cameras. No public data is needed to test that a layout is read, or that a recipe plans on it.

mod layouts;
mod opencv_yaml;
mod papers;
mod video;

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec2, DVec3};
use image::{GrayImage, Luma, Rgb, RgbImage};

pub use self::papers::papers;
pub use self::video::{FPS, has_ffmpeg};

/// The wall's distance from the origin along z, in metres. Cameras are at negative z and look along z.
const WALL: f64 = 1.5;
/// The radius of the ball at the origin.
const BALL: f64 = 0.6;
/// How far the ball moves along x from the first to the last frame.
const TRAVEL: f64 = 0.4;

/// A rig of cameras, and the sizes of what they film.
#[derive(Clone, Debug)]
pub struct Fake {
    /// Number of cameras, on an arc around the ball.
    pub cameras: usize,
    /// Number of frames per camera.
    pub frames: usize,
    /// Width and height of the images in pixels.
    pub size: (u32, u32),
    /// Whether all frames of a camera are hard links to its first one: fast, but nothing moves.
    pub is_still: bool,
    /// Whether images have one grey level: fast at any size.
    pub is_blank: bool,
}

/// A pinhole camera of the rig: world to view with OpenCV's axes, y = rotation · x + translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FakeCamera {
    /// World to view.
    pub rotation: DMat3,
    /// World to view.
    pub translation: DVec3,
    /// Focal length in pixels.
    pub focal: f64,
    /// Principal point in pixels.
    pub center: DVec2,
}

impl FakeCamera {
    /// The pixel position of a point in front of the camera.
    pub fn project(&self, point: DVec3) -> DVec2 {
        let view = self.rotation * point + self.translation;
        self.focal * view.truncate() / view.z + self.center
    }

    /// The centre of the camera in the world.
    pub fn position(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }
}

impl Fake {
    /// A rig with images of 24×16 pixels.
    pub fn small(cameras: usize, frames: usize) -> Self {
        Self { cameras, frames, size: (24, 16), is_still: false, is_blank: false }
    }

    /// Camera `index`. World: x right, y down, z away.
    pub fn camera(&self, index: usize) -> FakeCamera {
        let offset = index as f64 - 0.5 * (self.cameras.max(1) - 1) as f64;
        let angle = 0.12 * offset;
        let position = DVec3::new(4.0 * angle.sin(), 0.25 * (1.7 * index as f64).sin(), -4.0 * angle.cos());
        let forward = -position.normalize();
        let right = DVec3::Y.cross(forward).normalize();
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let (width, height) = (f64::from(self.size.0), f64::from(self.size.1));
        let center = 0.5 * DVec2::new(width, height);
        FakeCamera { rotation, translation: -(rotation * position), focal: 1.2 * width, center }
    }

    /// The point on the ball or the wall that `camera` sees through a pixel position at frame `frame`.
    pub fn seen(&self, camera: &FakeCamera, frame: usize, pixel: DVec2) -> DVec3 {
        let origin = camera.position();
        let plane = (pixel - camera.center) / camera.focal;
        let ray = camera.rotation.transpose() * plane.extend(1.0).normalize();
        let ball = self.ball(frame);
        let (along, off) = ((ball - origin).dot(ray), (ball - origin).length_squared());
        let inside = along * along - off + BALL * BALL;
        let distance = if inside > 0.0 { along - inside.sqrt() } else { (WALL - origin.z) / ray.z };
        origin + distance * ray
    }

    /// The distance of a point from the ball's surface at frame `frame` or from the wall, whichever is nearer.
    pub fn distance(&self, point: DVec3, frame: usize) -> f64 {
        let ball = self.ball(frame).distance(point) - BALL;
        ball.abs().min((point.z - WALL).abs())
    }

    /// The centre of the ball.
    fn ball(&self, frame: usize) -> DVec3 {
        DVec3::X * TRAVEL * frame as f64 / self.frames.max(2) as f64
    }

    /// What `camera` sees at `frame`.
    pub fn image(&self, camera: usize, frame: usize) -> RgbImage {
        if self.is_blank {
            return RgbImage::from_pixel(self.size.0, self.size.1, Rgb([128; 3]));
        }
        let view = self.camera(camera);
        RgbImage::from_fn(self.size.0, self.size.1, |column, row| {
            let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            texture(self.seen(&view, frame, pixel))
        })
    }

    /// Writes the frames of all cameras to the files that `path` names, as PNG or JPEG by their extension.
    pub fn write_frames(&self, path: impl Fn(usize, usize) -> PathBuf) {
        for camera in 0..self.cameras {
            let first = path(camera, 0);
            for frame in 0..self.frames {
                let file = path(camera, frame);
                make_folder_of(&file);
                if frame > 0 && self.is_still {
                    std::fs::hard_link(&first, &file).expect("files of one disk can be linked");
                } else {
                    self.image(camera, frame).save(&file).expect("the temporary folder can be written");
                }
            }
        }
    }
}

/// A colour that changes smoothly with the position, at several scales.
fn texture(point: DVec3) -> Rgb<u8> {
    let channel = |seed: u32| {
        let octave = |scale: f64, seed: u32| noise(point * scale, seed);
        let value = 0.5 * octave(4.0, seed) + 0.3 * octave(11.0, seed + 7) + 0.2 * octave(27.0, seed + 13);
        (255.0 * value) as u8
    };
    Rgb([channel(1), channel(2), channel(3)])
}

/// Interpolated pseudo-random values in [0, 1] at the integer points.
fn noise(point: DVec3, seed: u32) -> f64 {
    let (low, part) = (point.floor(), point - point.floor());
    let mut sum = 0.0;
    for corner in 0..8_u32 {
        let offset = DVec3::new(f64::from(corner & 1), f64::from(corner >> 1 & 1), f64::from(corner >> 2));
        let weight = DVec3::ONE - (part - offset).abs();
        let [x, y, z] = (low + offset).to_array().map(|value| value as i64 as u32);
        let mut hash = seed.wrapping_add(x.wrapping_mul(0x9E37_79B1)).wrapping_add(y.wrapping_mul(0x85EB_CA77));
        hash = hash.wrapping_add(z.wrapping_mul(0xC2B2_AE3D));
        hash = (hash ^ (hash >> 15)).wrapping_mul(0x2C1B_3C6D);
        hash = (hash ^ (hash >> 12)).wrapping_mul(0x297A_2D39);
        sum += weight.element_product() * f64::from(hash >> 8) / f64::from(1 << 24);
    }
    sum
}

/// Writes a grey PNG that is 255 where `is_set` returns true for a column and a row, and 0 elsewhere.
pub fn write_mask(file: &Path, (width, height): (u32, u32), is_set: impl Fn(u32, u32) -> bool) {
    make_folder_of(file);
    let mask = GrayImage::from_fn(width, height, |column, row| Luma([255 * u8::from(is_set(column, row))]));
    mask.save(file).expect("the temporary folder can be written");
}

/// Creates the folder of a file that will be written.
fn make_folder_of(file: &Path) {
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).expect("the temporary folder can be written");
    }
}

/// Writes a text or bytes to a file, with its folder.
pub fn write(file: &Path, content: impl AsRef<[u8]>) {
    make_folder_of(file);
    std::fs::write(file, content).expect("the temporary folder can be written");
}

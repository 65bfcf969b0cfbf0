//! The points that training starts from, and the PLY file that they may be in.

use std::path::PathBuf;

use glam::DVec3;
use scene::{Camera, PointCloud};

use crate::applied::Applied;
use crate::error::{Result, invalid};
use crate::files::name;

/// World positions and sRGB colours.
pub(crate) type Points = Vec<([f64; 3], [u8; 3])>;

/// Sample size of points and of cameras to decide in which frame a cloud is.
const SAMPLED: usize = 256;
/// Share of the projections into the images, relative to that in the other frame, below which a cloud is in the other frame.
const MISPLACED: f64 = 0.5;

/// The source of the points of a capture, if it is not read together with the poses.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum CloudSource {
    /// A file.
    File(CloudFile),
    /// The depth of the training frames.
    Depth,
    /// The COLMAP model in this folder, from which the poses come.
    Model(PathBuf),
    /// The training views of the first instant, in which points are searched for between these depths, if they are
    /// stated.
    Sweep(Option<[f64; 2]>),
}

/// A point cloud in the frame of the poses.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CloudFile {
    /// Where it lies.
    pub(crate) path: PathBuf,
    /// The transform from the original world to the frame of the poses.
    pub(crate) applied: Applied,
}

impl CloudFile {
    /// Reads the points in the original world.
    ///
    /// nerfstudio moves the cloud with the poses, but early versions left it in the original world. If the cameras see
    /// far less of the moved cloud than of the unchanged one, the cloud is left unchanged, with a warning.
    pub(crate) fn load(&self, cameras: &[Camera], warnings: &mut Vec<String>) -> Result<Points> {
        let (cloud, dropped) =
            PointCloud::read_finite_ply(&self.path).map_err(|error| invalid(error).at(&self.path))?;
        if dropped > 0 {
            warnings.push(format!("{dropped} points of {} are skipped: they are not finite", name(&self.path)));
        }
        let stated: Vec<DVec3> = cloud.positions.iter().map(|p| DVec3::from(p.map(f64::from))).collect();
        let undone: Vec<DVec3> = stated.iter().map(|point| self.applied.undo(*point)).collect();
        let as_it_is =
            !self.applied.is_identity() && seen_share(&undone, cameras) < MISPLACED * seen_share(&stated, cameras);
        if as_it_is {
            let name = name(&self.path);
            warnings
                .push(format!("{name} lacks applied_transform, which the poses have: its points are used as they are"));
        }
        let positions = if as_it_is { stated } else { undone };
        Ok(positions.iter().map(DVec3::to_array).zip(cloud.colors).collect())
    }
}

/// The share of the points that at least one camera sees.
pub(crate) fn share_in_view(points: &Points, cameras: &[Camera]) -> f64 {
    let points: Vec<DVec3> = sampled(points).map(|(position, _)| DVec3::from(*position)).collect();
    let seen = points.iter().filter(|point| sampled(cameras).any(|camera| sees(camera, point))).count();
    seen as f64 / points.len().max(1) as f64
}

/// The share of pairs of a point and a camera in which the point is inside the image.
fn seen_share(points: &[DVec3], cameras: &[Camera]) -> f64 {
    let points: Vec<&DVec3> = sampled(points).collect();
    let cameras: Vec<&Camera> = sampled(cameras).collect();
    let seen: usize = cameras.iter().map(|camera| points.iter().filter(|point| sees(camera, point)).count()).sum();
    seen as f64 / (points.len() * cameras.len()).max(1) as f64
}

/// The depths of the points that a camera sees, of a sample of them.
pub(crate) fn visible_depths(camera: &Camera, points: &Points) -> impl Iterator<Item = f64> {
    sampled(points).filter_map(|(position, _)| depth_in_view(camera, &DVec3::from(*position)))
}

/// Whether a point is in front of a camera and inside its image.
fn sees(camera: &Camera, point: &DVec3) -> bool {
    depth_in_view(camera, point).is_some()
}

/// The depth of a point in front of a camera and inside its image.
fn depth_in_view(camera: &Camera, point: &DVec3) -> Option<f64> {
    let (width, height) = (f64::from(camera.intrinsics.width), f64::from(camera.intrinsics.height));
    let (pixel, depth_view) = camera.project(*point)?;
    ((0.0..width).contains(&pixel.x) && (0.0..height).contains(&pixel.y)).then_some(depth_view)
}

/// At most about [`SAMPLED`] items, evenly spread.
fn sampled<T>(items: &[T]) -> impl Iterator<Item = &T> {
    items.iter().step_by(items.len().div_ceil(SAMPLED).max(1))
}

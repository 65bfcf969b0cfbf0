//! Surfels from the pixels of an image: positions from depth, orientations from normals, sizes from the pixel spacing.

use std::collections::HashSet;

use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::statistics::median;
use scene::{Camera, DepthMap, NormalMap};
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::{RasterSettings, SplatTensors, TooManyIntersections, render_image};
use shaders::tape::Tensor;

use crate::bases::seeds::SPACING_SHARE;
use crate::data::SceneFacts;
use crate::method::raster_settings;

/// Minimum cosine between normal and viewing axis: surfels on grazing surfaces are stretched at most ten times.
const MIN_COSINE: f64 = 0.1;
/// Relative difference above which two depths belong to different surfaces.
const DEPTH_JUMP: f64 = 0.05;
/// Coverage of a pixel below which its surface counts as new.
const COVERED: f32 = 0.5;
/// Opacity logit of the surfels in the coverage render: nearly opaque.
const COVERING_LOGIT: f32 = 4.0;
/// Thickness as a share of the smaller side.
pub(crate) const THICKNESS_SHARE: f64 = 0.01;

/// An image with its depth.
pub(crate) struct DepthImage<'a> {
    pub camera: &'a Camera,
    /// [H, W, 3] sRGB.
    pub pixels: &'a [u8],
    pub depth: &'a DepthMap,
    /// Normals, if known, and the depth map that they belong to. Where inpainting has replaced the depth, so that it
    /// differs from that map, the normals are not used.
    pub normals: Option<(&'a NormalMap, &'a DepthMap)>,
}

/// One flat Gaussian in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surfel {
    pub position: DVec3,
    /// Rotation from the surfel's axes to the world; the third axis is the surface normal.
    pub rotation: DQuat,
    /// Standard deviations along the first two axes, scene units.
    pub scales: [f64; 2],
    /// sRGB in [0, 1].
    pub color: [f64; 3],
    /// Normalised time and viewing direction (world) of the source view.
    pub birth_time: f64,
    pub birth_axis: DVec3,
}

impl Surfel {
    /// Standard deviation along the normal, scene units.
    pub(crate) fn thickness(&self) -> f64 {
        (THICKNESS_SHARE * self.scales[0].min(self.scales[1])).max(f64::from(f32::MIN_POSITIVE))
    }
}

impl DepthImage<'_> {
    /// One surfel on every `stride`-th pixel of every `stride`-th row, if the pixel has a depth and is `wanted`.
    pub(crate) fn surfels(&self, time: f64, stride: usize, wanted: impl Fn(usize) -> bool) -> Vec<Surfel> {
        let (width, height) = (self.depth.width as usize, self.depth.height as usize);
        let places = (stride / 2..height).step_by(stride).flat_map(|row| {
            (stride / 2..width).step_by(stride).map(move |column| (row * width + column, column, row)) //
        });
        let wanted = places.filter(|&(at, ..)| self.depth.depth_view[at] > 0.0 && wanted(at));
        wanted.map(|(at, column, row)| self.surfel(at, column, row, time, stride as f64)).collect()
    }

    fn surfel(&self, at: usize, column: usize, row: usize, time: f64, stride: f64) -> Surfel {
        let depth = f64::from(self.depth.depth_view[at]);
        let normal = self.normal(at, column, row);
        let camera = self.camera;
        // Inclination of the surface in the planes of the camera's axes.
        let cosine = |across: f64| (normal.z.abs() / across.hypot(normal.z)).max(MIN_COSINE);
        let side = |focal: f64, across: f64| SPACING_SHARE * stride * depth / (focal * cosine(across));
        let world_from_view = camera.camera_from_world.rotation.transpose();
        Surfel {
            position: camera.camera_from_world.inverse().apply(self.point_view(column, row, depth)),
            rotation: DQuat::from_mat3(&(world_from_view * axes(normal))),
            scales: [side(camera.intrinsics.focal_x, normal.x), side(camera.intrinsics.focal_y, normal.y)],
            color: [0, 1, 2].map(|channel| f64::from(self.pixels[3 * at + channel]) / 255.0),
            birth_time: time,
            birth_axis: world_from_view * DVec3::Z,
        }
    }

    /// Whether the normals are consistent with the depth: none are given, or at least one belongs to the depth of its
    /// pixel.
    pub(crate) fn normals_hold(&self) -> bool {
        let shown = &self.depth.depth_view;
        let holds = |(own, shown): (&f32, &f32)| own == shown && *own > 0.0;
        self.normals.is_none_or(|(_, own)| own.depth_view.iter().zip(shown).any(holds))
    }

    fn point_view(&self, column: usize, row: usize, depth: f64) -> DVec3 {
        self.camera.ray_view(DVec2::new(column as f64 + 0.5, row as f64 + 0.5)) * depth
    }

    /// The normal in the camera's frame: given, or estimated from the neighbours' depths, or pointing towards the
    /// camera.
    fn normal(&self, at: usize, column: usize, row: usize) -> DVec3 {
        let holding = self.normals.filter(|(_, depth)| depth.depth_view[at] == self.depth.depth_view[at]);
        let given = holding.map(|(map, _)| DVec3::from(map.normals_view[at].map(f64::from)));
        let towards_camera = -self.point_view(column, row, 1.0).normalize();
        given.and_then(DVec3::try_normalize).or_else(|| self.normal_of_depths(column, row)).unwrap_or(towards_camera)
    }

    fn normal_of_depths(&self, column: usize, row: usize) -> Option<DVec3> {
        let (width, height) = (self.depth.width as usize, self.depth.height as usize);
        let depth_at = |column: usize, row: usize| f64::from(self.depth.depth_view[row * width + column]);
        let here = depth_at(column, row);
        let point = |column: usize, row: usize| {
            let depth = depth_at(column, row);
            let same_surface = (depth - here).abs() <= DEPTH_JUMP * here;
            same_surface.then(|| self.point_view(column, row, depth))
        };
        let right = point((column + 1).min(width - 1), row)? - point(column.saturating_sub(1), row)?;
        let down = point(column, (row + 1).min(height - 1))? - point(column, row.saturating_sub(1))?;
        // Right × down points along the viewing axis; the normal points back.
        (-right.cross(down)).try_normalize()
    }
}

/// Axes of a surfel in the camera's frame: the first is horizontal, the third is the normal.
fn axes(normal: DVec3) -> DMat3 {
    let across = DVec3::Y.cross(normal);
    let first = if across.length_squared() > 1e-6 { across.normalize() } else { DVec3::X };
    let second = normal.cross(first).normalize();
    DMat3::from_cols(second.cross(normal), second, normal)
}

/// Mask of the pixels that `surfels` do not cover, or cover at another depth.
pub(crate) fn uncovered(
    surfels: &[Surfel],
    depth_image: &DepthImage<'_>,
    scene: &SceneFacts,
) -> Result<Vec<bool>, TooManyIntersections> {
    let settings = RasterSettings { depth: true, ..raster_settings(scene, 0) };
    let image = render_image(&covering_splats(surfels), &PinholeCamera::from(depth_image.camera), &settings)?;
    let drawn = image.depth.expect("the settings render depth");
    let is_new = |(at, &alpha): (usize, &f32)| {
        let depth = depth_image.depth.depth_view[at];
        let found = drawn.as_slice()[at] / alpha;
        let matches = alpha >= COVERED && (found - depth).abs() <= DEPTH_JUMP as f32 * depth;
        !matches
    };
    Ok(image.alpha.as_slice().iter().enumerate().map(is_new).collect())
}

fn covering_splats(surfels: &[Surfel]) -> SplatTensors<f32> {
    let count = surfels.len();
    let rows = |row_len: usize, values: Vec<f64>| {
        Tensor::from_vec([count, row_len], values.into_iter().map(|value| value as f32).collect())
    };
    SplatTensors {
        positions: rows(3, surfels.iter().flat_map(|surfel| surfel.position.to_array()).collect()),
        log_scales: rows(
            3,
            surfels.iter().flat_map(|s| [s.scales[0], s.scales[1], s.thickness()].map(f64::ln)).collect(),
        ),
        rotations: rows(4, surfels.iter().flat_map(|surfel| wxyz(surfel.rotation)).collect()),
        opacity_logits: Tensor::full([count, 1], COVERING_LOGIT),
        sh: Tensor::zeros([count, 1, 3]),
    }
}

/// The quaternion in tensor order, (w, x, y, z).
pub(crate) fn wxyz(rotation: DQuat) -> [f64; 4] {
    [rotation.w, rotation.x, rotation.y, rotation.z]
}

/// Keeps the first surfel in every cube with half the median spacing as its side.
pub(crate) fn without_duplicates(surfels: Vec<Surfel>) -> Vec<Surfel> {
    let spacings = surfels.iter().map(|surfel| surfel.scales[0].min(surfel.scales[1]) / SPACING_SHARE);
    let Some(spacing) = median(spacings) else { return surfels };
    let mut taken = HashSet::new();
    let cell = |surfel: &Surfel| (surfel.position / (0.5 * spacing)).floor().as_i64vec3().to_array();
    surfels.into_iter().filter(|surfel| taken.insert(cell(surfel))).collect()
}

//! Rendering of one shot: the image and its exact maps.

use glam::{DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::float_image::to_byte;
use scene::image_file::{GrayImage, RgbImage};
use scene::{Camera, DepthMap, FlowMap, Frame, LabelMap, PointCloud, VelocityMap, pixels};

use crate::params::{Background, Params, PointSurfaces, Truth};
use crate::ray::Ray;
use crate::shots::Shot;
use crate::world::{Hit, Instant, Shading, World};

/// Depth difference, relative to the depth of a point, above which a nearer surface occludes the point.
const OCCLUSION_TOLERANCE: f64 = 1e-6;
/// Maximum number of rays per requested surface point; if most of them miss, the cloud stays smaller.
const MAX_MISSES_PER_POINT: usize = 50;
/// Random stream of the surface points.
const POINT_STREAM: u64 = 2;
/// First of the random streams of holes, one per view.
const HOLE_STREAM: u64 = 16;

/// Renders the image and the requested maps of one shot.
pub(crate) fn render(world: &World, shot: &Shot, params: &Params) -> Frame {
    let instant = world.at(shot.time_secs);
    let (image, alpha) = antialiased(&instant, &shot.camera, params);
    let (width, height) = (params.width, params.height);
    let maps = [Truth::Depth, Truth::Flow, Truth::Masks, Truth::Velocity];
    let hits = if maps.iter().any(|map| params.wants(*map)) { center_hits(&instant, &shot.camera) } else { Vec::new() };
    let depth = |hit: &Option<Hit>| hit.map_or(0.0, |hit| hit.distance as f32);
    // Only depth and flow have holes.
    let known = with_holes(&hits, shot, params);
    let label = |hit: &Option<Hit>| hit.map_or(0, |hit| instant.label(&hit));
    let velocity = |hit: &Option<Hit>| {
        hit.map_or([0.0; 3], |hit| instant.velocity_world(hit.body, hit.material).as_vec3().to_array())
    };
    let next_secs = shot.time_secs + 1.0 / params.fps;
    // The flow of the last frame would lead beyond the capture.
    let has_next = next_secs <= params.duration_secs() * (1.0 + 1e-9);
    Frame {
        name: shot.name.clone(),
        split: shot.split,
        camera: shot.camera,
        camera_index: shot.camera_index,
        frame_index: shot.frame_index,
        time_secs: shot.time_secs,
        image,
        alpha: params.wants(Truth::Alpha).then_some(alpha),
        depth: params.wants(Truth::Depth).then(|| DepthMap {
            width,
            height,
            depth_view: known.iter().map(depth).collect(),
        }),
        flow: (params.wants(Truth::Flow) && has_next).then(|| FlowMap {
            width,
            height,
            flow_px: flow_px(&world.at(next_secs), &shot.camera, &known),
        }),
        mask: params.wants(Truth::Masks).then(|| LabelMap { width, height, labels: hits.iter().map(label).collect() }),
        velocity: params.wants(Truth::Velocity).then(|| VelocityMap {
            width,
            height,
            velocity_world: hits.iter().map(velocity).collect(),
        }),
    }
}

/// Removes a random share of the hits, drawn per view.
fn with_holes(hits: &[Option<Hit>], shot: &Shot, params: &Params) -> Vec<Option<Hit>> {
    let mut random = ChaCha8Rng::seed_from_u64(params.seed);
    let of_view = u64::from(shot.camera_index) << 32 | u64::from(shot.frame_index);
    random.set_stream(HOLE_STREAM + of_view);
    let mut keep = |hit: &Option<Hit>| hit.filter(|_| random.random::<f64>() >= params.holes);
    if params.holes > 0.0 { hits.iter().map(&mut keep).collect() } else { hits.to_vec() }
}

/// Samples coloured points on the surfaces that `params.points_on` names, at the first instant, through random pixels of the training cameras.
pub(crate) fn surface_points(world: &World, shots: &[Shot], params: &Params) -> PointCloud {
    let mut random = ChaCha8Rng::seed_from_u64(params.seed);
    random.set_stream(POINT_STREAM);
    let instant = world.at(0.0);
    let size = DVec2::new(f64::from(params.width), f64::from(params.height));
    let mut cloud = PointCloud::default();
    for _ in 0..params.points * MAX_MISSES_PER_POINT {
        if cloud.len() == params.points {
            break;
        }
        let camera = &shots[random.random_range(0..shots.len())].camera;
        let pixel = DVec2::new(random.random::<f64>(), random.random::<f64>()) * size;
        let ray = ray_world(camera, pixel);
        let has_points = |hit: &Hit| params.points_on == PointSurfaces::All || instant.label(hit) == 0;
        let Some(hit) = instant.hit(&ray).filter(has_points) else { continue };
        cloud.positions.push(ray.at(hit.distance).as_vec3().to_array());
        cloud.colors.push(instant.color(&ray, &hit, params.shading()).as_vec3().to_array().map(to_byte));
    }
    cloud
}

/// The ray through a pixel position. Its direction has view-space z = 1, so that distances along it are depths.
pub(crate) fn ray_world(camera: &Camera, pixel: DVec2) -> Ray {
    let world_from_camera = camera.camera_from_world.inverse();
    Ray { origin: world_from_camera.translation, direction: world_from_camera.rotation * camera.ray_view(pixel) }
}

/// Renders colour over the background, and coverage; each is the mean over a regular grid of rays per pixel.
fn antialiased(instant: &Instant, camera: &Camera, params: &Params) -> (RgbImage, GrayImage) {
    let (width, height, side) = (params.width, params.height, params.samples_per_side());
    let mut image = RgbImage::new(width, height);
    let mut alpha = GrayImage::new(width, height);
    let share = 1.0 / f64::from(side * side);
    let offset = |sample: u32| (f64::from(sample) + 0.5) / f64::from(side);
    let offsets: Vec<_> = (0..side * side).map(|at| DVec2::new(offset(at % side), offset(at / side))).collect();
    let behind = DVec3::splat(params.background.intensity());
    for (x, y, pixel) in image.enumerate_pixels_mut() {
        let corner = DVec2::new(f64::from(x), f64::from(y));
        let (mut color, mut covered) = (DVec3::ZERO, 0);
        for offset in &offsets {
            let ray = ray_world(camera, corner + offset);
            match instant.hit(&ray) {
                Some(hit) => {
                    color += instant.color(&ray, &hit, params.shading()).min(DVec3::ONE);
                    covered += 1;
                }
                None => color += behind,
            }
        }
        pixel.0 = (color * share).as_vec3().to_array().map(to_byte);
        alpha.get_pixel_mut(x, y).0 = [to_byte((f64::from(covered) * share) as f32)];
    }
    (image, alpha)
}

/// The first hit of the ray through each pixel centre, row by row.
pub(crate) fn center_hits(instant: &Instant, camera: &Camera) -> Vec<Option<Hit>> {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    pixels::centers(width, height).map(|center| instant.hit(&ray_world(camera, center))).collect()
}

/// Displacement of each visible material point in the image of the same camera until the next instant; NaN where the
/// point is then hidden or outside the image.
fn flow_px(next: &Instant, camera: &Camera, hits: &[Option<Hit>]) -> Vec<[f32; 2]> {
    let width = camera.intrinsics.width;
    let (width_px, height_px) = (f64::from(width), f64::from(camera.intrinsics.height));
    let flow = |(index, hit): (usize, &Option<Hit>)| {
        let hit = (*hit)?;
        let (moved, depth_view) = camera.project(next.position_world(hit.body, hit.material))?;
        let inside = moved.x >= 0.0 && moved.y >= 0.0 && moved.x <= width_px && moved.y <= height_px;
        let in_front = next.hit(&ray_world(camera, moved));
        let hidden = in_front.is_some_and(|other| other.distance < depth_view * (1.0 - OCCLUSION_TOLERANCE));
        (inside && !hidden).then(|| (moved - pixels::center(index, width)).as_vec2().to_array())
    };
    hits.iter().enumerate().map(|pixel| flow(pixel).unwrap_or([f32::NAN; 2])).collect()
}

impl Params {
    /// The options of shading.
    fn shading(&self) -> Shading {
        Shading { specular: self.specular, shadows: self.shadows }
    }
}

impl Background {
    /// Grey level in [0, 1] behind transparent pixels (which do not exist with a dome).
    pub(crate) fn intensity(self) -> f64 {
        match self {
            Self::White => 1.0,
            Self::Black | Self::None => 0.0,
        }
    }
}

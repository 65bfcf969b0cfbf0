//! Images and exact maps of one shot.

use glam::{DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::float_image::to_byte;
use scene::image_file::{GrayImage, RgbImage};
use scene::{Camera, DepthMap, FlowMap, Frame, LabelMap, PointCloud, VelocityMap};

use crate::params::{Background, Params, Truth};
use crate::shape::Ray;
use crate::shots::Shot;
use crate::world::{Hit, Instant, Shading, World};

/// A moved point is hidden if something lies in front of it by more than this share of its depth.
const OCCLUSION_TOLERANCE: f64 = 1e-6;
/// Rays that may miss for each wanted surface point before the cloud stays smaller.
const MAX_MISSES_PER_POINT: usize = 50;
/// Separates the random surface points from the other random numbers of the same seed.
const POINT_STREAM: u64 = 2;
/// The same for holes: the first of as many streams as there are views.
const HOLE_STREAM: u64 = 16;

/// Everything that the parameters ask for of one shot; maps that they do not ask for are not computed.
pub fn render(world: &World, shot: &Shot, params: &Params) -> Frame {
    let instant = world.at(shot.time_secs);
    let (image, alpha) = antialiased(&instant, &shot.camera, params);
    let (width, height) = (params.width, params.height);
    let maps = [Truth::Depth, Truth::Flow, Truth::Masks, Truth::Velocity];
    let hits = if maps.iter().any(|map| params.wants(*map)) { centre_hits(&instant, &shot.camera) } else { Vec::new() };
    let depth = |hit: &Option<Hit>| hit.map_or(0.0, |hit| hit.distance as f32);
    // What depth and flow know of: the other maps have no holes.
    let known = with_holes(&hits, shot, params);
    let label = |hit: &Option<Hit>| hit.map_or(0, |hit| instant.label(&hit));
    let velocity = |hit: &Option<Hit>| {
        hit.map_or([0.0; 3], |hit| instant.velocity_world(hit.body, hit.material).as_vec3().to_array())
    };
    let next_secs = shot.time_secs + 1.0 / params.fps;
    // The flow of the last frame would lead out of the capture.
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

/// The hits without a share of them, drawn per view.
fn with_holes(hits: &[Option<Hit>], shot: &Shot, params: &Params) -> Vec<Option<Hit>> {
    let mut random = ChaCha8Rng::seed_from_u64(params.seed);
    let of_view = u64::from(shot.camera_index) << 32 | u64::from(shot.frame_index);
    random.set_stream(HOLE_STREAM + of_view);
    let mut keep = |hit: &Option<Hit>| hit.filter(|_| random.random::<f64>() >= params.holes);
    if params.holes > 0.0 { hits.iter().map(&mut keep).collect() } else { hits.to_vec() }
}

/// Points on what random training pixels see at the first instant, with the colour that they see.
pub fn surface_points(world: &World, shots: &[Shot], params: &Params) -> PointCloud {
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
        let Some(hit) = instant.hit(&ray) else { continue };
        cloud.positions.push(ray.at(hit.distance).as_vec3().to_array());
        cloud.colors.push(instant.color(&ray, &hit, params.shading()).as_vec3().to_array().map(to_byte));
    }
    cloud
}

/// The ray through a pixel position; its direction has view-space z = 1, so that distances along it are depths.
pub fn ray_world(camera: &Camera, pixel: DVec2) -> Ray {
    let world_from_camera = camera.camera_from_world.inverse();
    Ray { origin: world_from_camera.translation, direction: world_from_camera.rotation * camera.ray_view(pixel) }
}

/// Colour over the background and coverage, each the mean over a regular grid of rays within the pixel.
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

/// What the centre of each pixel sees, row by row.
pub fn centre_hits(instant: &Instant, camera: &Camera) -> Vec<Option<Hit>> {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let centres = (0..height).flat_map(|y| (0..width).map(move |x| DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)));
    centres.map(|centre| instant.hit(&ray_world(camera, centre))).collect()
}

/// Displacement of each seen material point to where the same camera sees it at the next instant.
fn flow_px(next: &Instant, camera: &Camera, hits: &[Option<Hit>]) -> Vec<[f32; 2]> {
    let width = camera.intrinsics.width;
    let (width_px, height_px) = (f64::from(width), f64::from(camera.intrinsics.height));
    let flow = |(index, hit): (usize, &Option<Hit>)| {
        let hit = (*hit)?;
        let centre = DVec2::new((index as u32 % width) as f64 + 0.5, (index as u32 / width) as f64 + 0.5);
        let (moved, depth_view) = camera.project(next.position_world(hit.body, hit.material))?;
        let inside = moved.x >= 0.0 && moved.y >= 0.0 && moved.x <= width_px && moved.y <= height_px;
        let in_front = next.hit(&ray_world(camera, moved));
        let hidden = in_front.is_some_and(|other| other.distance < depth_view * (1.0 - OCCLUSION_TOLERANCE));
        (inside && !hidden).then(|| (moved - centre).as_vec2().to_array())
    };
    hits.iter().enumerate().map(|pixel| flow(pixel).unwrap_or([f32::NAN; 2])).collect()
}

impl Params {
    fn shading(&self) -> Shading {
        Shading { specular: self.specular, shadows: self.shadows }
    }
}

impl Background {
    /// Grey level behind transparent pixels (with a dome there are none).
    pub(crate) fn intensity(self) -> f64 {
        match self {
            Self::White => 1.0,
            Self::Black | Self::None => 0.0,
        }
    }
}

//! A model filmed: one image per time, from a camera that stands still or moves through views of the capture.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use anyhow::Context as _;
use engine::{Artifact as _, Failure, FailureKind};
use glam::{DMat3, DQuat, DVec3};
use scene::{Camera, Capture, RigidTransform, Split, image_file};
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::{Device, Tensor};
use training::{Model, Player};

use crate::export::{check_times, make_folder};
use crate::run::to_image;

/// How bright a pixel stays that is not what the prompt means.
const DIMMED: f32 = 0.2;

/// What to film.
#[derive(Clone, Debug)]
pub struct Film<'a> {
    /// Seconds of the capture, one for each frame; they may repeat, as where time stands still.
    pub times: &'a [f64],
    /// Names of views through whose cameras the camera moves, evenly over the frames; empty: it stands where the first test
    /// view was taken.
    pub views: &'a [String],
    /// One of the prompts that the model was trained with: what is something else is dimmed.
    pub prompt: Option<&'a str>,
}

/// Writes the frames as `frame_0000.png`, … into a folder that is not there yet or empty; tells what was written.
pub fn film(model_dir: &Path, capture_dir: &Path, film: &Film, device: Device, out: &Path) -> anyhow::Result<String> {
    let model = Model::open(model_dir)?;
    model.check().with_context(|| format!("not a valid model: {}", model_dir.display()))?;
    let capture = Capture::open(capture_dir)?;
    check_times(film.times, &capture)?;
    let cameras = cameras(&capture, film.views)?;
    let player = Player::new(&model)?.on(device);
    let prompt = film.prompt.map(|prompt| prompt_index(&player, &model.header.method, prompt)).transpose()?;
    make_folder(out)?;
    for (index, &time_secs) in film.times.iter().enumerate() {
        let share = index as f64 / (film.times.len() - 1).max(1) as f64;
        let camera = PinholeCamera::from(&camera_at(&cameras, share));
        let mut color = player.render(time_secs, &camera)?;
        if let Some(prompt) = prompt {
            dim(&mut color, &relevancy(&player, time_secs, &camera, prompt)?);
        }
        image_file::write_rgb(&out.join(format!("frame_{index:04}.png")), &to_image(&color))?;
    }
    let size = cameras[0].intrinsics;
    Ok(format!("{} frames of {} × {} px: {}", film.times.len(), size.width, size.height, out.display()))
}

/// The cameras of the named views, or that of the first test view (of the first training view if there is none).
fn cameras(capture: &Capture, names: &[String]) -> anyhow::Result<Vec<Camera>> {
    if names.is_empty() {
        let view = capture.views_of(Split::Test).next().or_else(|| capture.views_of(Split::Train).next());
        let (_, view) = view.with_context(|| format!("no view to film from: {}", capture.dir.display()))?;
        return Ok(vec![view.camera]);
    }
    let camera = |name: &String| {
        let view = capture.views.iter().find(|view| view.name == *name).ok_or_else(|| {
            let known: Vec<&str> = capture.views.iter().map(|view| view.name.as_str()).collect();
            let (first, last) = (known.first().unwrap_or(&""), known.last().unwrap_or(&""));
            let hint = format!("there are {} views, from {first} to {last}", known.len());
            Failure::new(FailureKind::BadInput, format!("the capture has no view {name:?}")).hint(hint).at(&capture.dir)
        })?;
        Ok(view.camera)
    };
    names.iter().map(camera).collect()
}

/// The camera after a share of the way through all cameras, with the pinhole of the first: around what they look at
/// together, or else in straight lines.
fn camera_at(cameras: &[Camera], share: f64) -> Camera {
    let place = share * (cameras.len() - 1) as f64;
    let first = (place as usize).min(cameras.len().saturating_sub(2));
    let [from, to] = [first, (first + 1).min(cameras.len() - 1)].map(|at| cameras[at].camera_from_world.inverse());
    let along = place - first as f64;
    let world_from_camera = match Orbit::of(cameras) {
        Some(orbit) => orbit.between(&from, &to, along),
        None => straight(&from, &to, along),
    };
    Camera { intrinsics: cameras[0].intrinsics, camera_from_world: world_from_camera.inverse() }
}

fn straight(from: &RigidTransform, to: &RigidTransform, along: f64) -> RigidTransform {
    RigidTransform {
        rotation: turned(from.rotation, to.rotation, along),
        translation: from.translation.lerp(to.translation, along),
    }
}

fn turned(from: DMat3, to: DMat3, along: f64) -> DMat3 {
    DMat3::from_quat(DQuat::from_mat3(&from).slerp(DQuat::from_mat3(&to), along).normalize())
}

/// The way around a point that cameras look at.
struct Orbit {
    focus_world: DVec3,
    /// Two horizontal axes and up, as columns.
    world_from_orbit: DMat3,
}

impl Orbit {
    /// The smallest determinant of the sum of the planes across the axes of cameras, per camera cubed: below, the axes are as
    /// good as parallel (5° apart for two cameras), and where they meet is anybody's guess.
    const LEAST_DETERMINANT: f64 = 1e-3;

    /// `None` if the cameras look at nothing together: fewer than two of them, parallel axes, or one that looks away.
    fn of(cameras: &[Camera]) -> Option<Self> {
        let poses: Vec<RigidTransform> = cameras.iter().map(|camera| camera.camera_from_world.inverse()).collect();
        // The point nearest to all optical axes: Σ (I − f·fᵀ)·(x − position) = 0.
        let across = |pose: &RigidTransform| {
            let forward = pose.rotation.z_axis;
            DMat3::IDENTITY - DMat3::from_cols(forward * forward.x, forward * forward.y, forward * forward.z)
        };
        let planes = poses.iter().map(across).fold(DMat3::ZERO, |sum, plane| sum + plane);
        if planes.determinant() < Self::LEAST_DETERMINANT * (cameras.len() as f64).powi(3) {
            return None;
        }
        let sum: DVec3 = poses.iter().map(|pose| across(pose) * pose.translation).sum();
        let focus_world = planes.inverse() * sum;
        let looks_there = |pose: &RigidTransform| (focus_world - pose.translation).dot(pose.rotation.z_axis) > 0.0;
        let up = -poses.iter().map(|pose| pose.rotation.y_axis).sum::<DVec3>().try_normalize()?;
        let x = up.any_orthonormal_vector();
        let world_from_orbit = DMat3::from_cols(x, up.cross(x), up);
        poses.iter().all(looks_there).then_some(Self { focus_world, world_from_orbit })
    }

    /// Azimuth, elevation and distance change evenly, and so does how a camera is turned from looking at the focus.
    fn between(&self, from: &RigidTransform, to: &RigidTransform, along: f64) -> RigidTransform {
        let [a, b] = [from, to].map(|pose| self.place(pose.translation));
        let turn = (b.x - a.x + PI).rem_euclid(TAU) - PI;
        let place = DVec3::new(a.x + along * turn, a.y + along * (b.y - a.y), a.z + along * (b.z - a.z));
        let looking = |place: DVec3| self.world_from_orbit * looking_inwards(place);
        let own = |pose: &RigidTransform, place| looking(place).transpose() * pose.rotation;
        let (sin, cos) = place.y.sin_cos();
        let direction = DVec3::new(cos * place.x.cos(), cos * place.x.sin(), sin);
        RigidTransform {
            rotation: looking(place) * turned(own(from, a), own(to, b), along),
            translation: self.focus_world + self.world_from_orbit * (place.z * direction),
        }
    }

    /// Azimuth, elevation and distance of a position.
    fn place(&self, position_world: DVec3) -> DVec3 {
        let offset = self.world_from_orbit.transpose() * (position_world - self.focus_world);
        DVec3::new(offset.y.atan2(offset.x), offset.z.atan2(offset.truncate().length()), offset.length())
    }
}

/// The axes of a camera at an azimuth and an elevation that looks at the middle: right, down, forward.
fn looking_inwards(place: DVec3) -> DMat3 {
    let ((sin_a, cos_a), (sin_e, cos_e)) = (place.x.sin_cos(), place.y.sin_cos());
    let forward = -DVec3::new(cos_e * cos_a, cos_e * sin_a, sin_e);
    let right = DVec3::new(-sin_a, cos_a, 0.0);
    DMat3::from_cols(right, forward.cross(right), forward)
}

/// Which of the prompts that the model knows a prompt is.
fn prompt_index(player: &Player, method: &str, prompt: &str) -> anyhow::Result<usize> {
    let names = player.prompt_names();
    if names.is_empty() || player.prompts().is_none() {
        let message = format!("a model of {method} that was trained without prompts answers none");
        let hint = "train l4dgs with features (effects language and semantics)";
        return Err(Failure::new(FailureKind::BadInput, message).hint(hint).into());
    }
    let found = names.iter().position(|name| name == prompt);
    Ok(found.ok_or_else(|| {
        let hint = format!("it was trained with {}", names.join(", "));
        Failure::new(FailureKind::BadInput, format!("the model does not know the prompt {prompt:?}")).hint(hint)
    })?)
}

/// How much every pixel is what the prompt means: [H·W] in [0, 1].
fn relevancy(player: &Player, time_secs: f64, camera: &PinholeCamera, prompt: usize) -> anyhow::Result<Vec<f32>> {
    let prompts = player.prompts().context("the model knows no prompts")?;
    let all = player.prompt_relevancy(time_secs, camera, &prompts)?.context("the model knows no meanings")?;
    Ok(all.as_slice().iter().skip(prompt).step_by(prompts.rows()).copied().collect())
}

/// Darkens an image [H, W, 3] where it is not relevant.
fn dim(color: &mut Tensor<f32>, relevancy: &[f32]) {
    let pixels = color.make_mut().as_chunks_mut::<3>().0;
    for (pixel, &relevancy) in pixels.iter_mut().zip(relevancy) {
        let brightness = DIMMED + (1.0 - DIMMED) * relevancy;
        pixel.iter_mut().for_each(|channel| *channel *= brightness);
    }
}

#[cfg(test)]
mod tests {
    use scene::Intrinsics;

    use super::*;

    const INTRINSICS: Intrinsics =
        Intrinsics { width: 20, height: 10, focal_x: 9.0, focal_y: 9.0, center_x: 10.0, center_y: 5.0 };

    fn assert_passes(cameras: &[Camera]) {
        for (index, camera) in cameras.iter().enumerate() {
            let found = camera_at(cameras, index as f64 / (cameras.len() - 1).max(1) as f64);
            let [found, expected] = [found, *camera].map(|camera| camera.camera_from_world);
            assert!(found.rotation.abs_diff_eq(expected.rotation, 1e-9), "{index}: {found:?}");
            assert!(found.translation.abs_diff_eq(expected.translation, 1e-9), "{index}: {found:?}");
        }
    }

    #[test]
    fn cameras_that_look_at_one_point_are_passed_around_it() {
        let focus = DVec3::new(0.3, -0.2, 0.1);
        let at = |x: f64, y: f64, z: f64| Camera::look_at(INTRINSICS, focus + DVec3::new(x, y, z), focus, DVec3::Z);
        let cameras = [at(3.0, 0.0, 1.0), at(0.0, 3.0, 1.0), at(-2.0, 0.5, 0.0)];
        assert_passes(&cameras);
        for step in 0..=20 {
            let camera = camera_at(&cameras, f64::from(step) / 20.0);
            let (pixel, depth) = camera.project(focus).unwrap();
            assert!(pixel.abs_diff_eq(glam::DVec2::new(10.0, 5.0), 1e-6), "{step}: {pixel}");
            assert!(depth > 2.0 && depth < 3.2, "{step}: {depth}");
        }
        let halfway = camera_at(&cameras[..2], 0.5).position_world() - focus;
        assert!((halfway.x - halfway.y).abs() < 1e-9 && (halfway.length() - 10.0_f64.sqrt()).abs() < 1e-9, "{halfway}");
    }

    #[test]
    fn cameras_side_by_side_are_passed_in_a_straight_line_and_one_camera_stands() {
        let at = |x: f64| {
            let position = DVec3::new(x, 0.0, 0.0);
            Camera::look_at(INTRINSICS, position, position + DVec3::Y, DVec3::Z)
        };
        let cameras = [at(0.0), at(1.0)];
        assert!(Orbit::of(&cameras).is_none());
        assert_passes(&cameras);
        assert!(camera_at(&cameras, 0.25).position_world().abs_diff_eq(DVec3::new(0.25, 0.0, 0.0), 1e-12));
        let alone = camera_at(&cameras[1..], 0.7).camera_from_world;
        assert!(alone.translation.abs_diff_eq(cameras[1].camera_from_world.translation, 1e-12));
    }

    #[test]
    fn what_is_not_relevant_is_dimmed() {
        let mut image = Tensor::full([1, 2, 3], 1.0);
        dim(&mut image, &[1.0, 0.0]);
        assert_eq!(image.as_slice(), [1.0, 1.0, 1.0, DIMMED, DIMMED, DIMMED]);
    }
}

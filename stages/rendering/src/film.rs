//! A model filmed: one image per time, from a camera that stands still or moves through views of the capture.

use std::path::Path;

use anyhow::Context as _;
use engine::{Artifact as _, Failure, FailureKind};
use glam::DQuat;
use scene::{Camera, Capture, RigidTransform, Split, image_file};
use shaders::splat::PinholeCamera;
use shaders::tape::{Device, Tensor};
use training::Model;
use training::player::Player;

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

/// The camera after a share of the way through all cameras: in straight lines, turning evenly, with the pinhole of the first.
fn camera_at(cameras: &[Camera], share: f64) -> Camera {
    let place = share * (cameras.len() - 1) as f64;
    let first = (place as usize).min(cameras.len().saturating_sub(2));
    let [from, to] = [first, (first + 1).min(cameras.len() - 1)].map(|at| cameras[at].camera_from_world.inverse());
    let along = place - first as f64;
    let turned = DQuat::from_mat3(&from.rotation).slerp(DQuat::from_mat3(&to.rotation), along);
    let world_from_camera = RigidTransform {
        rotation: glam::DMat3::from_quat(turned.normalize()),
        translation: from.translation.lerp(to.translation, along),
    };
    Camera { intrinsics: cameras[0].intrinsics, camera_from_world: world_from_camera.inverse() }
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
    use glam::DVec3;
    use scene::Intrinsics;

    use super::*;

    #[test]
    fn a_camera_goes_through_all_cameras_and_keeps_its_pinhole() {
        let intrinsics =
            Intrinsics { width: 20, height: 10, focal_x: 9.0, focal_y: 9.0, center_x: 10.0, center_y: 5.0 };
        let at = |x: f64, y: f64| Camera::look_at(intrinsics, DVec3::new(x, y, 1.0), DVec3::ZERO, DVec3::Z);
        let cameras = [at(3.0, 0.0), at(0.0, 3.0), at(-3.0, 0.0)];
        for (index, share) in [(0, 0.0), (1, 0.5), (2, 1.0)] {
            let [found, expected] = [camera_at(&cameras, share), cameras[index]].map(|camera| camera.camera_from_world);
            assert!(found.rotation.abs_diff_eq(expected.rotation, 1e-12), "{share}");
            assert!(found.translation.abs_diff_eq(expected.translation, 1e-12), "{share}");
        }
        let between = camera_at(&cameras, 0.25);
        assert!(between.position_world().abs_diff_eq(DVec3::new(1.5, 1.5, 1.0), 1e-12));
        // Half of the turn: what both cameras have in the middle column stays there.
        assert!((between.project(DVec3::ZERO).unwrap().0.x - 10.0).abs() < 1e-9);
        assert_eq!(camera_at(&cameras[..1], 0.7), camera_at(&cameras[..1], 0.0));
    }

    #[test]
    fn what_is_not_relevant_is_dimmed() {
        let mut image = Tensor::full([1, 2, 3], 1.0);
        dim(&mut image, &[1.0, 0.0]);
        assert_eq!(image.as_slice(), [1.0, 1.0, 1.0, DIMMED, DIMMED, DIMMED]);
    }
}

//! Rendered surfaces: coverage, depth, velocity and optical flow, for comparison with exact maps.
//!
//! Velocity and flow are finite differences over time of the Gaussians' positions, blended with the weights of the
//! colours. They are therefore defined for every method, independently of its motion model.

use anyhow::Context as _;
use scene::{Camera, View};
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::RasterSettings;
use shaders::tape::Tensor;
use training::Player;

use crate::artifact::SurfaceMaps;

/// Blended values per Gaussian: velocity (x, y, z), flow (right, down), and 1 for one that moves.
const BLENDED: usize = 6;
/// A Gaussian is static if it is present this many frames earlier and later (clamped to the clip), and its displacement
/// in the image between the two is at most [`RESTING_PX_PER_FRAME`] per frame, or undefined because it is behind the
/// camera.
const RESTING_FRAMES: f64 = 4.0;
/// Maximum image displacement of a static Gaussian, pixels per frame ([`RESTING_FRAMES`]).
const RESTING_PX_PER_FRAME: f64 = 0.125;

/// Renders the surfaces of a view; `frame_secs` is the time between two frames of the capture.
pub(crate) fn surfaces(player: &Player, view: &View, frame_secs: f64) -> anyhow::Result<SurfaceMaps> {
    let camera = PinholeCamera::from(&view.camera);
    let mut tape = player.tape();
    let splats = player.splats(&mut tape, view.time_secs, &camera)?;
    let motion = motion_of_rows(player, view, frame_secs)?;
    let features = tape.constant(Tensor::from_vec([motion.len() / BLENDED, BLENDED], motion));
    let settings = RasterSettings { depth: true, ..player.raster_settings() };
    let rendered = player.rasterize(&mut tape, &splats, Some(features), &camera, &settings)?;
    let values = |var| tape.value(var).as_slice();
    let alpha = values(rendered.alpha);
    let depth = values(rendered.depth.context("depth was requested")?);
    let blended = values(rendered.features.context("features were given")?);
    let (width, height) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    let mut maps = SurfaceMaps { width, height, alpha: alpha.to_vec(), ..SurfaceMaps::default() };
    for ((&alpha, &depth), sums) in alpha.iter().zip(depth).zip(blended.as_chunks::<BLENDED>().0) {
        let share = if alpha >= SurfaceMaps::COVERED { 1.0 / alpha } else { 0.0 };
        let [x, y, z, right, down, moving] = sums.map(|sum| sum * share);
        maps.depth_view.push(depth * share);
        maps.velocity_world.push([x, y, z]);
        maps.flow_px.push([right, down]);
        maps.moving.push(moving);
    }
    Ok(maps)
}

/// [N, 6]: velocity, flow and motion of every splat in the view.
fn motion_of_rows(player: &Player, view: &View, frame_secs: f64) -> anyhow::Result<Vec<f32>> {
    let camera = PinholeCamera::from(&view.camera);
    let range = player.time_range_secs();
    let at = |time_secs: f64| player.positions(time_secs.clamp(range[0], range[1]), &camera);
    let (now_secs, half) = (view.time_secs, 0.5 * frame_secs);
    let [before_secs, after_secs] = [now_secs - half, now_secs + half].map(|secs| secs.clamp(range[0], range[1]));
    let (before, now, after, next) = (at(before_secs)?, at(now_secs)?, at(after_secs)?, at(now_secs + frame_secs)?);
    let [early_secs, late_secs] =
        [-RESTING_FRAMES, RESTING_FRAMES].map(|frames| (now_secs + frames * frame_secs).clamp(range[0], range[1]));
    let (early, late) = (at(early_secs)?, at(late_secs)?);
    let resting_px = (RESTING_PX_PER_FRAME * (late_secs - early_secs) / frame_secs) as f32;
    let duration = (after_secs - before_secs).max(f64::MIN_POSITIVE);
    let mut motion = Vec::with_capacity(BLENDED * now.world.len());
    for (index, position) in now.world.iter().enumerate() {
        let row = now.row(index);
        // A splat that is absent at one of the two times has no velocity.
        let velocity = match (before.of_row(row), after.of_row(row)) {
            (Some(from), Some(to)) => [0, 1, 2].map(|axis| ((to[axis] - from[axis]) as f64 / duration) as f32),
            _ => [0.0; 3],
        };
        let flow = next.of_row(row).and_then(|to| displacement_px(&view.camera, *position, to)).unwrap_or([0.0; 2]);
        motion.extend(velocity);
        motion.extend(flow);
        let shift = early.of_row(row).zip(late.of_row(row)).map(|(from, to)| displacement_px(&view.camera, from, to));
        let rests = shift.is_some_and(|shift| shift.is_none_or(|[x, y]| x.hypot(y) <= resting_px));
        motion.push(f32::from(u8::from(!rests)));
    }
    Ok(motion)
}

/// Image displacement between two points; `None` if one of them is behind the camera.
fn displacement_px(camera: &Camera, from: [f32; 3], to: [f32; 3]) -> Option<[f32; 2]> {
    let project = |point: [f32; 3]| Some(camera.project(glam::Vec3::from(point).as_dvec3())?.0);
    Some((project(to)? - project(from)?).as_vec2().to_array())
}

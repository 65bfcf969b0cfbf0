//! What a render says of surfaces: coverage, depth, velocity and optical flow, for comparison with exact maps.
//!
//! Velocity and flow are differences of the model's own positions over time, blended with the weights of the colours:
//! they are defined for every method, whatever its motion model is.

use std::path::Path;

use anyhow::Context as _;
use scene::{Camera, View, exr_file};
use shaders::splat::{PinholeCamera, RasterSettings};
use shaders::tape::{Device, Tape, Tensor};
use training::player::Player;

/// Coverage from which on a pixel shows a surface.
pub const COVERED: f32 = 0.5;
/// Names of the channels in files.
const CHANNELS: [&str; 7] = ["A", "Z", "velocity.X", "velocity.Y", "velocity.Z", "flow.X", "flow.Y"];
/// Values per Gaussian that are blended: velocity (x, y, z) and flow (right, down).
const BLENDED: usize = 5;

/// The surfaces that a render shows; everything but `alpha` is 0 where `alpha` is below [`COVERED`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceMaps {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// [H, W] coverage in [0, 1].
    pub alpha: Vec<f32>,
    /// [H, W] mean view-space z, scene units.
    pub depth_view: Vec<f32>,
    /// [H, W] mean velocity, world, scene units per second.
    pub velocity_world: Vec<[f32; 3]>,
    /// [H, W] mean displacement until the next frame as the same camera sees it, pixels.
    pub flow_px: Vec<[f32; 2]>,
}

impl SurfaceMaps {
    /// Reads what [`SurfaceMaps::write`] wrote.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let image = exr_file::read(path)?;
        let channel = |at: usize| {
            let values = image.channel(&[CHANNELS[at]]);
            values.with_context(|| format!("no channel {}: {}", CHANNELS[at], path.display()))
        };
        let (alpha, depth_view) = (channel(0)?.to_vec(), channel(1)?.to_vec());
        let (x, y, z, right, down) = (channel(2)?, channel(3)?, channel(4)?, channel(5)?, channel(6)?);
        let (width, height) = (image.width, image.height);
        let velocity_world = (0..alpha.len()).map(|at| [x[at], y[at], z[at]]).collect();
        let flow_px = (0..alpha.len()).map(|at| [right[at], down[at]]).collect();
        Ok(Self { width, height, alpha, depth_view, velocity_world, flow_px })
    }

    /// Writes an EXR file with the channels A, Z, velocity.X to velocity.Z, flow.X and flow.Y.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        let velocity = |axis: usize| self.velocity_world.iter().map(|velocity| velocity[axis]).collect();
        let flow = |axis: usize| self.flow_px.iter().map(|flow| flow[axis]).collect();
        let values: [Vec<f32>; 7] =
            [self.alpha.clone(), self.depth_view.clone(), velocity(0), velocity(1), velocity(2), flow(0), flow(1)];
        let channels: Vec<(&str, Vec<f32>)> = CHANNELS.into_iter().zip(values).collect();
        Ok(exr_file::write(path, self.width, self.height, &channels)?)
    }
}

/// Renders the surfaces of a view; `frame_secs` is the time between two frames of the capture.
pub fn surfaces(player: &Player, view: &View, frame_secs: f64) -> anyhow::Result<SurfaceMaps> {
    let camera = PinholeCamera::from(&view.camera);
    let mut tape = Tape::new(Device::Cpu);
    let splats = player.splats(&mut tape, view.time_secs, &camera)?;
    let motion = motion_of_rows(player, view, frame_secs)?;
    let features = tape.constant(Tensor::from_vec([motion.len() / BLENDED, BLENDED], motion));
    let settings = RasterSettings { depth: true, ..player.raster_settings() };
    let rendered = player.rasterize(&mut tape, &splats, Some(features), &camera, &settings)?;
    let values = |var| tape.value(var).as_slice();
    let alpha = values(rendered.alpha);
    let depth = values(rendered.depth.context("depth was asked for")?);
    let blended = values(rendered.features.context("features were given")?);
    let (width, height) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    let mut maps = SurfaceMaps { width, height, alpha: alpha.to_vec(), ..SurfaceMaps::default() };
    for ((&alpha, &depth), sums) in alpha.iter().zip(depth).zip(blended.as_chunks::<BLENDED>().0) {
        let share = if alpha >= COVERED { 1.0 / alpha } else { 0.0 };
        let [x, y, z, right, down] = sums.map(|sum| sum * share);
        maps.depth_view.push(depth * share);
        maps.velocity_world.push([x, y, z]);
        maps.flow_px.push([right, down]);
    }
    Ok(maps)
}

/// [N, 5]: velocity and flow of every splat of the view.
fn motion_of_rows(player: &Player, view: &View, frame_secs: f64) -> anyhow::Result<Vec<f32>> {
    let camera = PinholeCamera::from(&view.camera);
    let range = player.time_range_secs();
    let at = |time_secs: f64| player.positions(time_secs.clamp(range[0], range[1]), &camera);
    let (now_secs, half) = (view.time_secs, 0.5 * frame_secs);
    let [before_secs, after_secs] = [now_secs - half, now_secs + half].map(|secs| secs.clamp(range[0], range[1]));
    let (before, now, after, next) = (at(before_secs)?, at(now_secs)?, at(after_secs)?, at(now_secs + frame_secs)?);
    let duration = (after_secs - before_secs).max(f64::MIN_POSITIVE);
    let mut motion = Vec::with_capacity(BLENDED * now.world.len());
    for (index, position) in now.world.iter().enumerate() {
        let row = now.row(index);
        // A splat that is not there at another instant has no velocity of its own.
        let velocity = match (before.of_row(row), after.of_row(row)) {
            (Some(from), Some(to)) => [0, 1, 2].map(|axis| ((to[axis] - from[axis]) as f64 / duration) as f32),
            _ => [0.0; 3],
        };
        let flow = next.of_row(row).and_then(|to| displacement_px(&view.camera, *position, to)).unwrap_or([0.0; 2]);
        motion.extend(velocity);
        motion.extend(flow);
    }
    Ok(motion)
}

/// From where a camera sees one point to where it sees another; `None` if one lies behind it.
fn displacement_px(camera: &Camera, from: [f32; 3], to: [f32; 3]) -> Option<[f32; 2]> {
    let project = |point: [f32; 3]| Some(camera.project(glam::Vec3::from(point).as_dvec3())?.0);
    Some((project(to)? - project(from)?).as_vec2().to_array())
}

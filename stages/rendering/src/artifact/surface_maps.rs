//! The file of rendered surfaces: coverage, depth, velocity and optical flow, per pixel.

use std::path::Path;

use anyhow::Context as _;
use scene::exr_file;

/// The surfaces of one render. Everything but `alpha` is 0 where `alpha` is below [`SurfaceMaps::COVERED`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceMaps {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// [H, W] coverage in [0, 1].
    pub alpha: Vec<f32>,
    /// [H, W] mean view-space z in scene units.
    pub depth_view: Vec<f32>,
    /// [H, W] mean velocity in world coordinates, scene units per second.
    pub velocity_world: Vec<[f32; 3]>,
    /// [H, W] mean displacement until the next frame in the image of the same camera, in pixels.
    pub flow_px: Vec<[f32; 2]>,
    /// [H, W] share of the weight of Gaussians that move, or are absent four frames earlier or later, in [0, 1].
    pub moving: Vec<f32>,
}

impl SurfaceMaps {
    /// Minimum coverage of a pixel that shows a surface.
    pub const COVERED: f32 = 0.5;
    /// Channel names in files.
    const CHANNELS: [&str; 8] = ["A", "Z", "velocity.X", "velocity.Y", "velocity.Z", "flow.X", "flow.Y", "moving"];

    /// Reads a file of [`SurfaceMaps::write`]. A missing channel is an error.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let image = exr_file::read(path)?;
        let channel = |at: usize| {
            let values = image.channel(&[Self::CHANNELS[at]]);
            values.with_context(|| format!("no channel {}: {}", Self::CHANNELS[at], path.display()))
        };
        let (alpha, depth_view) = (channel(0)?.to_vec(), channel(1)?.to_vec());
        let (x, y, z, right, down) = (channel(2)?, channel(3)?, channel(4)?, channel(5)?, channel(6)?);
        let (width, height) = (image.width, image.height);
        let velocity_world = (0..alpha.len()).map(|at| [x[at], y[at], z[at]]).collect();
        let flow_px = (0..alpha.len()).map(|at| [right[at], down[at]]).collect();
        let moving = channel(7)?.to_vec();
        Ok(Self { width, height, alpha, depth_view, velocity_world, flow_px, moving })
    }

    /// Writes an EXR file with the channels `A`, `Z`, `velocity.X`, `velocity.Y`, `velocity.Z`, `flow.X`, `flow.Y` and `moving`.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        let velocity = |axis: usize| self.velocity_world.iter().map(|velocity| velocity[axis]).collect();
        let flow = |axis: usize| self.flow_px.iter().map(|flow| flow[axis]).collect();
        let (alpha, depth, moving) = (self.alpha.clone(), self.depth_view.clone(), self.moving.clone());
        let values: [Vec<f32>; 8] = [alpha, depth, velocity(0), velocity(1), velocity(2), flow(0), flow(1), moving];
        let channels: Vec<(&str, Vec<f32>)> = Self::CHANNELS.into_iter().zip(values).collect();
        Ok(exr_file::write(path, self.width, self.height, &channels)?)
    }
}

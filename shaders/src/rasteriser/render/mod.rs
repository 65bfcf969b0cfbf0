//! Rendering of 3D Gaussians: [`projection`](crate::rasteriser::projection), [`binning`](crate::rasteriser::binning) and
//! [`blending`](crate::rasteriser::blending) composed, with or without gradients.

#[cfg(test)]
mod fuzz_tests;
#[cfg(test)]
mod gpu_tests;
#[cfg(test)]
pub(crate) mod scene_tests;
#[cfg(test)]
mod tests;

use crate::rasteriser::binning::TooManyIntersections;
use std::sync::Arc;

use crate::geometry::camera::PinholeCamera;
use crate::rasteriser::binning::{self, Grid, Lists, TILE};
use crate::rasteriser::blending::{self, Blended};
use crate::rasteriser::projection;
use crate::rasteriser::settings::RasterSettings;
use crate::rasteriser::splats::{SplatTensors, SplatVars};
use crate::tape::{Device, Real, Tape, Tensor, Var};

/// A render with the values that density control reads.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// [H, W, 3].
    pub color: Var,
    /// [H, W].
    pub alpha: Var,
    /// [H, W]: Σ wᵢzᵢ, not divided by alpha; present if [`RasterSettings::depth`].
    pub depth: Option<Var>,
    /// [H, W, F]: Σ wᵢfᵢ; present if features were given.
    pub features: Option<Var>,
    /// [N, 2] px: its gradient, in units of 1/px, drives density control.
    pub means2d: Var,
    /// [N, 3]: A, k and m of each conic (see `projection`).
    pub conics: Var,
    lists: Arc<Lists>,
    blended_pixel_splats: Option<u64>,
}

/// Statistics of a render; on a GPU, each call is a readback.
impl Rendered {
    /// The number of splats that were given.
    pub fn splats<T: Real>(&self, tape: &Tape<T>) -> usize {
        tape.value(self.means2d).rows()
    }

    /// `[N]`: whether any tile holds the splat.
    pub fn visible(&self) -> Vec<bool> {
        self.lists.visible()
    }

    /// `[N]`: three standard deviations along the longer axis, in px; 0 where invisible.
    pub fn radii_px<T: Real>(&self, tape: &Tape<T>) -> Vec<f32> {
        let conics = tape.value(self.conics).as_slice().as_chunks::<3>().0;
        let radius = |(conic, is_visible): (&[T; 3], bool)| if is_visible { radius_px(conic) } else { 0.0 };
        conics.iter().zip(self.visible()).map(radius).collect()
    }

    /// The amount of work of the render; read back from a GPU.
    pub fn stats(&self) -> RenderStats {
        let intersections = self.lists.entry_count();
        RenderStats {
            visible: self.lists.visible_count(),
            intersections,
            nominal_pixel_splats: (intersections * TILE * TILE) as u64,
            blended_pixel_splats: self.blended_pixel_splats,
        }
    }

    /// The lists of splats per tile.
    pub(crate) fn lists(&self) -> &Lists {
        &self.lists
    }
}

/// The amount of work of a render.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderStats {
    /// Splats that some tile holds.
    pub visible: usize,
    /// (Tile, splat) pairs.
    pub intersections: usize,
    /// (Pixel, splat) pairs of all intersections: the nominal work.
    pub nominal_pixel_splats: u64,
    /// (Pixel, splat) pairs that were blended; not counted on a GPU.
    pub blended_pixel_splats: Option<u64>,
}

/// Renders splats and, with the same weights, their `features` [N, F]; differentiable in all parameters and features.
pub fn render<T: Real>(
    tape: &mut Tape<T>,
    splats: &SplatVars,
    features: Option<Var>,
    camera: &PinholeCamera,
    settings: &RasterSettings,
) -> Result<Rendered, TooManyIntersections> {
    let projected = projection::project(tape, splats, camera, settings);
    let grid = Grid { width: camera.width, height: camera.height };
    let lists = binning::bin(tape, &projected, grid)?;
    let Blended { color, alpha, depth, features, blended_count } =
        blending::blend(tape, &projected, features, &lists, settings);
    let (means2d, conics) = (projected.means2d, projected.conics);
    let blended_pixel_splats = blended_count;
    Ok(Rendered { color, alpha, depth, features, means2d, conics, lists, blended_pixel_splats })
}

/// Images without gradients.
#[derive(Clone, Debug)]
pub struct RenderedImage<T: Real> {
    /// [H, W, 3].
    pub color: Tensor<T>,
    /// [H, W].
    pub alpha: Tensor<T>,
    /// [H, W]; present if [`RasterSettings::depth`].
    pub depth: Option<Tensor<T>>,
}

/// Renders images on the CPU without gradients.
pub fn render_image<T: Real>(
    splats: &SplatTensors<T>,
    camera: &PinholeCamera,
    settings: &RasterSettings,
) -> Result<RenderedImage<T>, TooManyIntersections> {
    let mut tape = Tape::new(Device::Cpu);
    let vars = splats.constants(&mut tape);
    let rendered = render(&mut tape, &vars, None, camera, settings)?;
    let image = |var: Var| tape.value(var).clone();
    let (color, alpha, depth) = (image(rendered.color), image(rendered.alpha), rendered.depth.map(image));
    Ok(RenderedImage { color, alpha, depth })
}

/// Three times the root of the larger eigenvalue of the covariance behind (A, k, m).
fn radius_px<T: Real>(conic: &[T; 3]) -> f32 {
    let [a, k, m] = conic.map(|value| value.to_f64());
    let (variance_x, variance_y, covariance) = (1.0 / a + k * k / m, 1.0 / m, -k / m);
    let gap = (0.5 * (variance_x - variance_y)).hypot(covariance);
    (3.0 * (0.5 * (variance_x + variance_y) + gap).sqrt()) as f32
}

//! Statistics of the splats of a training's renders, computed on the GPU that rendered: which splats a mask covers, and the
//! sums that density control needs (Kerbl et al. 2023, section 5.2).

mod covered;
#[cfg(test)]
mod tests;

pub use covered::covered;

use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::rasteriser::binning::Lists;
use crate::rasteriser::render::Rendered;
use crate::tape::{Gradients, Tape, Tensor};

const SCREEN: Kernel = Kernel { name: "screen statistics", text: include_str!("screen.wgsl") };
/// Columns of the statistics.
pub const COLUMNS: usize = 3;

uniforms! {
    struct ViewBlock as "View" {
        count: u32,
        half_width: f32,
        half_height: f32,
        has_gradient: u32,
        renders: f32,
    }
}

/// The gradient of a splat in a step with several renders, each of which has its share of the step's loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepGradient {
    /// The norm of the sum over the renders: gradients of different directions cancel.
    OfSum,
    /// The mean norm over the renders that show the splat, each with its whole loss (Yang et al. 2024, published code):
    /// with R renders, R times the sum of the norms divided by the number of renders that show it.
    MeanOverViews,
}

/// A render, and the population rows that its splats belong to.
pub struct PopulationRender<'a> {
    /// The render.
    pub rendered: &'a Rendered,
    /// Width and height.
    pub size_px: [f64; 2],
    /// The population row of each of the first splats, every row at most once; further splats belong to no row. `None`:
    /// splat i is row i.
    pub row_of_splat: Option<&'a [u32]>,
}

impl PopulationRender<'_> {
    /// The splat of each of `count` rows, on a GPU; `u32::MAX` for rows without a splat.
    fn splat_of_row(&self, gpu: Gpu, count: usize) -> Option<GpuArray> {
        let rows = self.row_of_splat?;
        let mut splats = vec![u32::MAX; count];
        rows.iter().enumerate().for_each(|(splat, &row)| splats[row as usize] = splat as u32);
        Some(GpuArray::upload(gpu, &splats))
    }
}

/// Adds the renders of one step to statistics [N, 3], and returns the new ones: the sum over steps of the norm of the
/// gradient with respect to the projected mean, in normalised device coordinates and as `step_gradient` defines it; the
/// number of steps in which the splat was visible; its largest radius in px. `None` if the renders are not on a GPU.
pub fn observe(
    tape: &Tape<f32>,
    gradients: &Gradients<f32>,
    renders: &[PopulationRender],
    step_gradient: StepGradient,
    statistics: &Tensor<f32>,
) -> Option<Tensor<f32>> {
    let gpu = tape.device().gpu()?;
    let (count, last) = (statistics.rows(), renders.len().checked_sub(1)?);
    let (sums, observed) = (GpuArray::new(gpu, 4 * count * last.min(1)), GpuArray::new(gpu, COLUMNS * count));
    for (index, render) in renders.iter().enumerate() {
        let PopulationRender { rendered, size_px, row_of_splat } = render;
        let Lists::Gpu(lists) = rendered.lists() else { return None };
        let splats = lists.rank_of_splat.len();
        assert!(row_of_splat.map_or(count, |rows| rows.len()) <= splats, "a splat for every row of statistics");
        let splat_of_row = render.splat_of_row(gpu, count);
        let conics = tape.value(rendered.conics).on_gpu(gpu);
        let gradient = gradients.get(rendered.means2d).map(|gradient| gradient.on_gpu(gpu));
        let [half_width, half_height] = size_px.map(|size| (0.5 * size) as f32);
        let has_gradient = u32::from(gradient.is_some());
        let (count_u32, renders) = (count as u32, renders.len() as f32);
        let constants = ViewBlock { count: count_u32, half_width, half_height, has_gradient, renders };
        let read =
            [gradient.unwrap_or(conics), conics, &lists.rank_of_splat, statistics.on_gpu(gpu)].map(Binding::Read);
        let splats = Binding::Read(splat_of_row.as_ref().unwrap_or(&lists.rank_of_splat));
        let arrays = [&read[..], &[&sums, &observed].map(Binding::Write), &[splats]].concat();
        let rows = ("ROWS", u32::from(splat_of_row.is_some()));
        let views = ("VIEWS", u32::from(step_gradient == StepGradient::MeanOverViews));
        let specialisation = [("FIRST", u32::from(index == 0)), ("LAST", u32::from(index == last)), rows, views];
        SCREEN.launch(gpu, &specialisation, &constants, &arrays, Groups::Over(count));
    }
    Some(Tensor::from_gpu([count, COLUMNS], observed))
}

//! What the renders of a training say about their splats, added up for density control (Kerbl et al. 2023, section 5.2)
//! without leaving the GPU.

#[cfg(test)]
mod tests;

use crate::binning::Lists;
use crate::gpu::{Binding, GpuArray, Kernel, uniforms};
use crate::splat::Rendered;
use crate::tape::{Gradients, Tape, Tensor};

const SCREEN: Kernel = Kernel { name: "screen statistics", text: &[include_str!("screen.wgsl")] };
/// Splats per workgroup.
const GROUP: usize = 256;
/// Columns of the statistics.
pub const COLUMNS: usize = 3;

uniforms! {
    struct LookBlock as "Look" {
        count: u32,
        half_width: f32,
        half_height: f32,
        has_gradient: u32,
    }
}

/// A render of all splats of a population.
pub struct Look<'a> {
    pub rendered: &'a Rendered,
    /// Width and height.
    pub size_px: [f64; 2],
}

/// Adds the renders of one step to statistics [N, 3]: the sum over steps of the norm of the gradient by the projected mean,
/// in normalised device coordinates and summed over the renders; steps that saw the splat; its largest radius in pixels.
/// `None` if the renders are not on a GPU.
pub fn observe(
    tape: &Tape<f32>,
    gradients: &Gradients<f32>,
    looks: &[Look],
    statistics: &Tensor<f32>,
) -> Option<Tensor<f32>> {
    let gpu = tape.device().gpu()?;
    let (count, last) = (statistics.rows(), looks.len().checked_sub(1)?);
    let (sums, observed) = (GpuArray::new(gpu, 4 * count * last.min(1)), GpuArray::new(gpu, COLUMNS * count));
    for (index, Look { rendered, size_px }) in looks.iter().enumerate() {
        let Lists::Gpu(lists) = rendered.lists() else { return None };
        assert_eq!(lists.rank_of_splat.len(), count, "a row of statistics for every splat");
        let conics = tape.value(rendered.conics).on_gpu(gpu);
        let gradient = gradients.get(rendered.means2d).map(|gradient| gradient.on_gpu(gpu));
        let [half_width, half_height] = size_px.map(|size| (0.5 * size) as f32);
        let has_gradient = u32::from(gradient.is_some());
        let constants = LookBlock { count: count as u32, half_width, half_height, has_gradient };
        let read =
            [gradient.unwrap_or(conics), conics, &lists.rank_of_splat, statistics.on_gpu(gpu)].map(Binding::Read);
        let arrays = [&read[..], &[&sums, &observed].map(Binding::Write)].concat();
        let specialisation = [("FIRST", u32::from(index == 0)), ("LAST", u32::from(index == last))];
        SCREEN.launch(gpu, &specialisation, &constants, &arrays, count.div_ceil(GROUP));
    }
    Some(Tensor::from_gpu([count, COLUMNS], observed))
}

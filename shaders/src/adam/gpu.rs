//! The update on a GPU: one launch for all groups, and nothing is read back. Values and moments become new arrays, because
//! other tensors may share the old ones.

use super::{Coefficients, Group};
use crate::gpu::grouped::{Grouped, Item, ItemArray};
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, WORKGROUP_SIZE, uniforms};
use crate::tape::Tensor;

const ADAM: Grouped = Grouped {
    kernel: Kernel { name: "adam", text: include_str!("adam.wgsl") },
    shared: 1,
    arrays: &[
        ItemArray::read("gradients"),
        ItemArray::read("values"),
        ItemArray::read("first_moments"),
        ItemArray::read("second_moments"),
        ItemArray::write("new_values"),
        ItemArray::write("new_first_moments"),
        ItemArray::write("new_second_moments"),
    ],
};

/// Elements per invocation, and invocations per workgroup.
const ELEMENTS: usize = 4;
/// The largest magnitude of the gradient, and that of the new values.
pub(crate) const FIGURES: usize = 2;

uniforms! {
    struct AdamItem as "Item" {
        beta1: f32,
        beta2: f32,
        step_size: f32,
        second_moment_scale: f32,
        epsilon: f32,
        len: u32,
        maxima: u32,
    }
}

fn specialisation() -> [(&'static str, u32); 1] {
    [("ELEMENTS", ELEMENTS as u32)]
}

/// A group whose step counter has been advanced, its gradient, and the scalars of its update.
pub(super) type Counted<'a> = (&'a mut Group, &'a Tensor<f32>, Coefficients);

/// Updates groups; the largest magnitudes of each, [groups, 2].
pub(super) fn advance(gpu: Gpu, updates: &mut [Counted]) -> Tensor<f32> {
    let figures = GpuArray::zeros(gpu, FIGURES * updates.len());
    let new = |(_, gradient, _): &Counted| [(); 3].map(|()| GpuArray::new(gpu, gradient.len()));
    let written: Vec<[GpuArray; 3]> = updates.iter().map(new).collect();
    let numbered = updates.iter().zip(&written).enumerate();
    let items = numbered.flat_map(|(index, (update, written))| items(gpu, index, update, written));
    ADAM.launch(gpu, &specialisation(), &[Binding::Write(&figures)], &items.collect::<Vec<_>>());
    for ((group, gradient, _), written) in updates.iter_mut().zip(written) {
        group.replace(written.map(|array| Tensor::from_gpu(gradient.shape(), array)));
    }
    Tensor::from_gpu([updates.len(), FIGURES], figures)
}

fn items<'a>(
    gpu: Gpu,
    index: usize,
    (group, gradient, coefficients): &'a Counted,
    written: &'a [GpuArray; 3],
) -> Vec<Item<'a, AdamItem>> {
    let Coefficients { beta1, beta2, step_size, second_moment_scale, epsilon } = *coefficients;
    let maxima = (FIGURES * index) as u32;
    let [values, first, second] = group.tensors();
    let read = [gradient, values, first, second].map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
    let arrays: Vec<Binding> = read.into_iter().chain(written.iter().map(Binding::Write)).collect();
    let constants = |len| AdamItem { beta1, beta2, step_size, second_moment_scale, epsilon, len, maxima };
    Item::in_parts(gpu, gradient.len(), WORKGROUP_SIZE * ELEMENTS, &arrays, constants)
}

#[cfg(test)]
#[test]
fn the_kernel_is_valid() {
    crate::gpu::grouped::tests::assert_valid_grouped::<AdamItem>(&ADAM, &specialisation());
}

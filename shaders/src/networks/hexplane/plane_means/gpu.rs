//! Means over planes: one launch for all planes of all means.

use super::{PlaneMean, Term};
use crate::arrays::sums::{BLOCK, LANES};
use crate::gpu::grouped::{Grouped, Item, ItemArray};
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, WORKGROUP_SIZE, uniforms};
use crate::tape::{Backward, Real, Tensor, total_on_gpu};

const SUMS: Grouped = Grouped {
    kernel: Kernel { name: "plane means", text: include_str!("plane_sums.wgsl") },
    shared: 1,
    arrays: &[ItemArray::read("values")],
};

const TOTALS: Grouped = Grouped {
    kernel: Kernel { name: "plane means, totals", text: include_str!("plane_totals.wgsl") },
    shared: 1,
    arrays: &[ItemArray::write("total")],
};

const GRADIENTS: Grouped = Grouped {
    kernel: Kernel { name: "plane means backward", text: include_str!("plane_gradient.wgsl") },
    shared: 0,
    arrays: &[
        ItemArray::read("values"),
        ItemArray::read("dy_difference"),
        ItemArray::read("dy_distance"),
        ItemArray::write("gradient"),
    ],
};

uniforms! {
    struct SumsItem as "Item" {
        row_len: u32,
        terms: u32,
        factor: f32,
        first_sum: u32,
        mean: u32,
    }
}

uniforms! {
    struct TotalsItem as "Item" {
        first: u32,
        end: u32,
    }
}

uniforms! {
    struct GradientItem as "Item" {
        rows: u32,
        row_len: u32,
        difference_factor: f32,
        distance_factor: f32,
        adds: u32,
    }
}

/// 1 over the number of elements of a mean; 0 if it is empty.
fn factor<T: Real>(mean: PlaneMean, plane: &Tensor<T>) -> f32 {
    match mean.terms(plane) {
        0 => 0.0,
        terms => 1.0 / terms as f32,
    }
}

/// For every term the sum over its planes of the means: [1] each.
pub(crate) fn sums_of_means<T: Real>(gpu: Gpu, planes: &[&Tensor<T>], terms: &[Term]) -> Vec<Tensor<T>> {
    let (mut count, mut items, mut runs) = (0, Vec::new(), Vec::new());
    for Term { mean, planes: chosen } in terms {
        let first = count;
        for plane in chosen.iter().map(|&index| planes[index]) {
            let (terms, groups) = (mean.terms(plane), mean.terms(plane).div_ceil(BLOCK));
            let [row_len, terms, first_sum] = [plane.row_len(), terms, count].map(|size| size as u32);
            let constants = SumsItem { row_len, terms, factor: factor(*mean, plane), first_sum, mean: *mean as u32 };
            items.push(Item { constants, arrays: vec![Binding::Read(plane.on_gpu(gpu))], groups });
            count += groups;
        }
        runs.push(TotalsItem { first: first as u32, end: count as u32 });
    }
    let sums = GpuArray::new(gpu, count);
    SUMS.launch(gpu, &[LANES], &[Binding::Write(&sums)], &items);
    let totals: Vec<GpuArray> = terms.iter().map(|_| GpuArray::new(gpu, 1)).collect();
    let mut items = Vec::new();
    for (constants, total) in runs.into_iter().zip(&totals) {
        items.push(Item { constants, arrays: vec![Binding::Write(total)], groups: 1 });
    }
    TOTALS.launch(gpu, &[LANES], &[Binding::Read(&sums)], &items);
    totals.into_iter().map(|total| Tensor::from_gpu([1], total)).collect()
}

/// Adds the gradients of the terms, times their upstream gradients, to the totals of the planes that need one.
pub(crate) fn add_mean_gradients<T: Real>(
    gpu: Gpu,
    pass: Backward<T>,
    terms: &[Term],
    totals: &mut [Option<Tensor<T>>],
) {
    let Backward { inputs: planes, output_grads: dys, needs, .. } = pass;
    let mut items = Vec::new();
    for (index, (plane, total)) in planes.iter().zip(totals).enumerate().filter(|(index, _)| needs[*index]) {
        let arriving = |mean: PlaneMean| {
            let asks = |(term, _): &(&Term, _)| term.mean == mean && term.planes.contains(&index);
            terms.iter().zip(dys).find(asks).and_then(|(_, dy)| *dy)
        };
        let means = [PlaneMean::SecondDifference, PlaneMean::DistanceToOne];
        let dys = means.map(arriving);
        if dys.iter().all(Option::is_none) {
            continue;
        }
        let (gradient, adds) = total_on_gpu(gpu, total, plane.shape());
        let factors = [0, 1].map(|at| dys[at].map_or(0.0, |_| factor(means[at], plane)));
        let constants = GradientItem {
            rows: plane.rows() as u32,
            row_len: plane.row_len() as u32,
            difference_factor: factors[0],
            distance_factor: factors[1],
            adds: u32::from(adds),
        };
        let read = [Some(*plane), dys[0], dys[1]].map(|tensor| Binding::Read(tensor.unwrap_or(plane).on_gpu(gpu)));
        let arrays = read.into_iter().chain([Binding::Write(gradient)]).collect();
        items.push(Item { constants, arrays, groups: plane.len().div_ceil(WORKGROUP_SIZE) });
    }
    GRADIENTS.launch(gpu, &[], &[], &items);
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    use crate::gpu::grouped::tests::assert_valid_grouped;
    assert_valid_grouped::<SumsItem>(&SUMS, &[LANES]);
    assert_valid_grouped::<TotalsItem>(&TOTALS, &[LANES]);
    assert_valid_grouped::<GradientItem>(&GRADIENTS, &[]);
}

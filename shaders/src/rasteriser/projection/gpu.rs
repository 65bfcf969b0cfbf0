//! The kernels of projection.

use super::reference::View;
use super::{Projection, ShapeInputs};
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::{Real, Tensor, upstream};

/// Projects every splat, and counts the events of [`super::guards::EVENTS`].
pub(super) const FORWARD: Kernel = Kernel { name: "projection", text: include_str!("projection.wgsl") };
pub(super) const BACKWARD: Kernel = Kernel { name: "projection backward", text: include_str!("projection_bwd.wgsl") };

uniforms! {
    /// The constants `View` of the kernels.
    struct ViewBlock as "View" {
        rows: [[f32; 4]; 3],
        position_world: [f32; 3],
        alpha_cap: f32,
        focal: [f32; 2],
        center: [f32; 2],
        size: [f32; 2],
        near: f32,
        far: f32,
        slope_low: [f32; 2],
        slope_high: [f32; 2],
        dilation: f32,
        alpha_min: f32,
        count: u32,
        sh_len: u32,
    }
}

/// The specialisation of the kernels.
pub(super) fn specialisation(sh_degree: usize, shapes: ShapeInputs) -> [(&'static str, u32); 2] {
    [("SH_DEGREE", sh_degree as u32), ("GIVEN_FACTORS", u32::from(shapes == ShapeInputs::Factors))]
}

impl ViewBlock {
    fn new<T: Real>(view: &View<T>, count: usize, sh_len: usize, alpha_cap: f64) -> Self {
        let f = |value: T| value.to_f64() as f32;
        let row = |axis: usize| {
            let [x, y, z] = view.rotation[axis].map(f);
            [x, y, z, f(view.translation[axis])]
        };
        let [x, y, z] = view.position_world.map(f);
        let [(low_x, high_x), (low_y, high_y)] = view.slope_range;
        Self {
            rows: [row(0), row(1), row(2)],
            position_world: [x, y, z],
            alpha_cap: alpha_cap as f32,
            focal: view.focal.map(f),
            center: view.center.map(f),
            size: view.size.map(f),
            near: f(view.near),
            far: f(view.far),
            slope_low: [low_x, low_y].map(f),
            slope_high: [high_x, high_y].map(f),
            dilation: f(view.dilation),
            alpha_min: f(view.alpha_min),
            count: count as u32,
            sh_len: sh_len as u32,
        }
    }
}

/// Positions, logits, harmonics, shapes and rotations; a placeholder is bound if there are no rotations.
fn parameters<'a, T: Real>(gpu: Gpu, inputs: &[&'a Tensor<T>]) -> Vec<Binding<'a>> {
    let rotations = inputs.get(4).unwrap_or(&inputs[3]);
    inputs[..4].iter().chain([rotations]).map(|input| Binding::Read(input.on_gpu(gpu))).collect()
}

impl<T: Real> Projection<T> {
    fn block(&self, count: usize) -> ViewBlock {
        ViewBlock::new(&self.view, count, self.sh_len, self.alpha_cap)
    }

    /// Means, conics, depths, opacities, colours, cutoffs; and the counts of [`super::guards::EVENTS`].
    pub(super) fn project_on_gpu(&self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let count = inputs[0].rows();
        let shapes = [vec![count, 2], vec![count, 3], vec![count], vec![count], vec![count, 3], vec![count]];
        let arrays: Vec<GpuArray> = shapes.iter().map(|shape| GpuArray::new(gpu, shape.iter().product())).collect();
        let mut bindings = parameters(gpu, inputs);
        bindings.extend(arrays.iter().map(Binding::Write));
        let events = self.events.as_ref().expect("there on a GPU");
        bindings.push(Binding::Write(events));
        let specialisation = specialisation(self.view.sh_degree, ShapeInputs::of(inputs));
        FORWARD.launch(gpu, &specialisation, &self.block(count), &bindings, Groups::Over(count));
        shapes.into_iter().zip(arrays).map(|(shape, array)| Tensor::from_gpu(shape, array)).collect()
    }

    /// The gradients of all inputs.
    pub(super) fn backward_on_gpu(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        cutoffs: &Tensor<T>,
        output_grads: &[Option<&Tensor<T>>],
    ) -> Vec<Option<Tensor<T>>> {
        let count = inputs[0].rows();
        let mut bindings = parameters(gpu, inputs);
        let cutoffs = cutoffs.on_gpu(gpu);
        bindings.push(Binding::Read(cutoffs));
        let (mask, gradients) = upstream(gpu, &output_grads[..5], cutoffs);
        bindings.extend(gradients);
        let gradients: Vec<GpuArray> = inputs.iter().map(|input| GpuArray::new(gpu, input.len())).collect();
        bindings.extend(gradients.iter().map(Binding::Write));
        let no_rotations = (inputs.len() == 4).then(|| GpuArray::new(gpu, 1));
        bindings.extend(no_rotations.iter().map(Binding::Write));

        let [degree, given] = specialisation(self.view.sh_degree, ShapeInputs::of(inputs));
        let specialisation = [degree, given, ("ARRIVING", mask)];
        BACKWARD.launch(gpu, &specialisation, &self.block(count), &bindings, Groups::Over(count));
        gradients.into_iter().zip(inputs).map(|(array, input)| Some(Tensor::from_gpu(input.shape(), array))).collect()
    }
}

#[cfg(test)]
#[test]
fn kernels_are_valid_for_every_degree_and_shape() {
    use crate::gpu::layout_tests::{check_layout, validate};
    for degree in 0..=3 {
        for shapes in [ShapeInputs::ScalesAndRotations, ShapeInputs::Factors] {
            let [degree, given] = specialisation(degree, shapes);
            let sources = [FORWARD.source(&[degree, given]), BACKWARD.source(&[degree, given, ("ARRIVING", 0b10101)])];
            for source in sources {
                validate(&source).unwrap_or_else(|error| panic!("{error}"));
                check_layout::<ViewBlock>(&source).unwrap_or_else(|error| panic!("{error}"));
            }
        }
    }
    let shifted = FORWARD.source(&specialisation(3, ShapeInputs::Factors)).replacen("dilation: f32,", "", 1);
    assert!(check_layout::<ViewBlock>(&shifted).is_err());
}

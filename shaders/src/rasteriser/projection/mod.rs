//! Projection of 3D Gaussians to the image: means, conics, depths, opacities, colours and cutoffs.
//!
//! With R = camera_from_world, the covariance in px² is VVᵀ + εI, V = J·R·R_q·diag(eˢ) (Zwicker et al. 2002, EWA splatting),
//! where J is the affine map of the perspective at the splat's centre; any other factor of the covariance can stand for
//! R_q·diag(eˢ). A pixel at distance (dx, dy) = mean − pixel sees
//! alpha = opacity·e^(−σ), σ = ½(A(dx + k·dy)² + m·dy²): the Cholesky form of the conic, which is never negative.
//! Colour is max(0, ½ + Σ Yₖ·shₖ) in the direction from the camera's centre (Kerbl et al. 2023).

mod factors;
mod gpu;
mod guards;
mod harmonics;
mod reference;
mod shape;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use rayon::prelude::*;

pub use factors::joined;
pub(crate) use guards::Culled;
pub use guards::NOT_FINITE;

use crate::geometry::camera::PinholeCamera;
use crate::gpu::{Gpu, GpuArray};
use crate::rasteriser::settings::RasterSettings;
use crate::rasteriser::splats::{ShapeVars, SplatVars};
use crate::tape::{Backward, DeferredCount, GpuOp, Op, Real, Tape, Tensor, Var};
use reference::{Projected, Splat, SplatGradient, View};
use shape::Shape;

/// The local affine map is evaluated at most this fraction of the image size outside the image (Kerbl et al. 2023).
const CLAMP_MARGIN: f64 = 0.15;

/// Splats per parallel chunk: tens of microseconds.
const SPLATS_PER_CHUNK: usize = 256;

/// N splats in the image. A culled splat has zeros everywhere, a cutoff of −1 or less, and gets no gradient.
#[derive(Clone, Copy, Debug)]
pub struct ProjectedVars {
    /// [N, 2] px.
    pub means2d: Var,
    /// [N, 3]: A, k, m with A and m in px⁻².
    pub conics: Var,
    /// `[N]` z in view space, scene units.
    pub depths: Var,
    /// `[N]`.
    pub opacities: Var,
    /// [N, 3].
    pub colors: Var,
    /// `[N]`: the largest σ that is blended, ln(255·opacity); the one threshold that culling and blending share. No gradient
    /// flows through it.
    pub cutoffs: Var,
}

/// Projects splats. Panics if shapes disagree or `sh` has too few coefficients for the degree.
pub fn project<T: Real>(
    tape: &mut Tape<T>,
    splats: &SplatVars,
    camera: &PinholeCamera,
    settings: &RasterSettings,
) -> ProjectedVars {
    assert!(settings.near_view > 0.0, "the near plane must lie in front of the camera");
    let count = tape.value(splats.positions).rows();
    let sh_len = tape.value(splats.sh).row_len();
    let needed = 3 * harmonics::coefficient_count(settings.sh_degree);
    assert!(settings.sh_degree <= 3, "spherical harmonics go up to degree 3");
    assert!(count == 0 || sh_len >= needed, "degree {} needs {needed} coefficients, not {sh_len}", settings.sh_degree);
    let mut inputs = vec![(splats.positions, 3), (splats.opacity_logits, 1), (splats.sh, sh_len)];
    match splats.shape {
        ShapeVars::ScaleRotation { log_scales, rotations } => inputs.extend([(log_scales, 3), (rotations, 4)]),
        ShapeVars::Factor(factors) => inputs.push((factors, 9)),
    }
    for &(var, row_len) in &inputs {
        assert_eq!(tape.value(var).len(), count * row_len, "projection: a parameter has the wrong shape");
    }
    let inputs: Vec<Var> = inputs.into_iter().map(|(var, _)| var).collect();
    let events = tape.device().gpu().map(|gpu| Arc::new(GpuArray::zeros(gpu, guards::EVENTS.len())));
    let view = View::<T>::new(camera, settings);
    let projection = Projection { view, sh_len, alpha_cap: settings.alpha_cap, events: events.clone() };
    let outputs = tape.apply(projection, &inputs);
    let [means2d, conics, depths, opacities, colors, cutoffs] = outputs[..] else { unreachable!("six outputs") };
    let projected = ProjectedVars { means2d, conics, depths, opacities, colors, cutoffs };
    match events {
        Some(counts) => tape.defer(DeferredCount::Events { names: guards::EVENTS.to_vec(), counts }),
        None => guards::count(tape, &projected, camera, settings),
    }
    projected
}

struct Projection<T> {
    view: View<T>,
    sh_len: usize,
    alpha_cap: f64,
    /// The counts of [`guards::EVENTS`] on a GPU.
    events: Option<Arc<GpuArray>>,
}

/// The form of the inputs after positions, opacities and harmonics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ShapeInputs {
    ScalesAndRotations,
    Factors,
}

impl ShapeInputs {
    fn of<T: Real>(inputs: &[&Tensor<T>]) -> Self {
        if inputs.len() == 4 { Self::Factors } else { Self::ScalesAndRotations }
    }
}

impl<T: Real> Projection<T> {
    fn splat<'a>(&self, inputs: &[&'a Tensor<T>], index: usize) -> Splat<'a, T> {
        Splat {
            position: row(inputs[0], index),
            opacity_logit: inputs[1].as_slice()[index],
            sh: &inputs[2].as_slice()[index * self.sh_len..][..self.sh_len],
            shape: match &inputs[3..] {
                [log_scales, rotations] => {
                    Shape::ScaleRotation { log_scales: row(log_scales, index), rotation: row(rotations, index) }
                }
                [factors] => Shape::Factor([0, 1, 2].map(|axis| row(factors, 3 * index + axis))),
                _ => unreachable!("scales and rotations, or factors"),
            },
        }
    }

    /// The gradient of a splat; `None` if it was culled.
    fn splat_backward(
        &self,
        inputs: &[&Tensor<T>],
        outputs: &[&Tensor<T>],
        output_grads: &[Option<&Tensor<T>>],
        index: usize,
        sh_gradient: &mut [T],
    ) -> Option<SplatGradient<T>> {
        if outputs[5].as_slice()[index] < T::ZERO {
            return None;
        }
        reference::backward(&self.splat(inputs, index), &self.view, &upstream_of(output_grads, index), sh_gradient)
    }
}

impl<T: Real> Op<T> for Projection<T> {
    fn name(&self) -> &'static str {
        "projection"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let count = inputs[0].rows();
        let project = |index| {
            let splat = self.splat(inputs, index);
            reference::project(&splat, &self.view).ok_or_else(|| reference::why_culled(&splat, &self.view))
        };
        let projected: Vec<Result<Projected<T>, Culled>> =
            (0..count).into_par_iter().with_min_len(SPLATS_PER_CHUNK).map(project).collect();
        let culled = Culled::ALL.map(|why| Projected { cutoff: T::from_f64(why.code()), ..Projected::default() });
        let all = || projected.iter().map(|splat| splat.as_ref().unwrap_or_else(|why| &culled[*why as usize]));
        vec![
            Tensor::from_vec([count, 2], all().flat_map(|splat| splat.mean2d).collect()),
            Tensor::from_vec([count, 3], all().flat_map(|splat| splat.conic).collect()),
            Tensor::from_vec([count], all().map(|splat| splat.depth).collect()),
            Tensor::from_vec([count], all().map(|splat| splat.opacity).collect()),
            Tensor::from_vec([count, 3], all().flat_map(|splat| splat.color).collect()),
            Tensor::from_vec([count], all().map(|splat| splat.cutoff).collect()),
        ]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, output_grads, .. } = pass;
        let mut gradients: Vec<Vec<T>> = inputs.iter().map(|input| vec![T::ZERO; input.len()]).collect();
        let [positions, logits, sh, shapes @ ..] = &mut gradients[..] else { unreachable!("four or five inputs") };
        let rows = positions.as_chunks_mut::<3>().0.par_iter_mut().zip(logits);
        let rows = rows.zip(sh.par_chunks_exact_mut(self.sh_len.max(1))).with_min_len(SPLATS_PER_CHUNK).enumerate();
        let of_row = |index: usize, position: &mut [T; 3], logit: &mut T, sh: &mut [T]| {
            let gradient = self.splat_backward(inputs, outputs, output_grads, index, sh)?;
            (*position, *logit) = (gradient.position, gradient.opacity_logit);
            Some(gradient.shape)
        };
        match shapes {
            [log_scales, rotations] => {
                let shapes = log_scales.as_chunks_mut::<3>().0.par_iter_mut().zip(rotations.as_chunks_mut::<4>().0);
                rows.zip(shapes).for_each(|((index, ((position, logit), sh)), shape)| {
                    let gradient = of_row(index, position, logit, sh);
                    if let Some(Shape::ScaleRotation { log_scales, rotation }) = gradient {
                        (*shape.0, *shape.1) = (log_scales, rotation);
                    }
                });
            }
            [factors] => {
                let shapes = factors.par_chunks_exact_mut(9);
                rows.zip(shapes).for_each(|((index, ((position, logit), sh)), shape)| {
                    if let Some(Shape::Factor(factor)) = of_row(index, position, logit, sh) {
                        shape.copy_from_slice(factor.as_flattened());
                    }
                });
            }
            _ => unreachable!("scales and rotations, or factors"),
        }
        gradients.into_iter().zip(inputs).map(|(data, input)| Some(Tensor::from_vec(input.shape(), data))).collect()
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Projection<T> {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(self.project_on_gpu(gpu, inputs))
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, output_grads, .. } = pass;
        self.backward_on_gpu(gpu, inputs, outputs[5], output_grads)
    }
}

/// The upstream gradient of one projected splat; zero if there is none.
fn upstream_of<T: Real>(output_grads: &[Option<&Tensor<T>>], index: usize) -> Projected<T> {
    Projected {
        mean2d: output_grads[0].map_or_else(Default::default, |gradient| row(gradient, index)),
        conic: output_grads[1].map_or_else(Default::default, |gradient| row(gradient, index)),
        depth: output_grads[2].map_or(T::ZERO, |gradient| gradient.as_slice()[index]),
        opacity: output_grads[3].map_or(T::ZERO, |gradient| gradient.as_slice()[index]),
        color: output_grads[4].map_or_else(Default::default, |gradient| row(gradient, index)),
        cutoff: T::ZERO,
    }
}

fn row<T: Real, const LEN: usize>(tensor: &Tensor<T>, index: usize) -> [T; LEN] {
    tensor.as_slice().as_chunks::<LEN>().0[index]
}

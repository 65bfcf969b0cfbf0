//! The visible share of the Gaussians: the part of their weight that no Gaussian in front of them absorbs.

use std::f64::consts::TAU;

use shaders::arrays::rows::{columns, concat_columns};
use shaders::geometry::camera::PinholeCamera;
use shaders::pointwise;
use shaders::pointwise::{mul, sigmoid};
use shaders::rasteriser::{self, RasterSettings, ShapeVars, SplatVars};
use shaders::tape::{Real, Tape, Tensor};

use super::VISIBILITY;
use crate::bases::canonical::scales_and_rotations;
use crate::data::TrainingView;
use crate::method::{Step, too_large};

/// Passes the weights of the Gaussians of a view to the hooks.
pub(crate) fn measure<T: Real>(
    step: &mut Step<'_, T>,
    splats: &SplatVars,
    view: &TrainingView<T>,
) -> anyhow::Result<()> {
    step.clock.enter("visibility");
    let (child, weights) = weights(step.tape, splats, &view.camera, &step.raster)?;
    step.tape.absorb(child);
    let weights = step.tape.constant(weights);
    step.measure(VISIBILITY, weights);
    step.clock.enter("motion");
    Ok(())
}

/// [N, 2] for the Gaussians in an image: opacity times the visible share, and opacity; with the tape of the render. The
/// visible share is the sum of a Gaussian's weights in the image over their sum in an unbounded image without other
/// Gaussians: 1 for unoccluded Gaussians, 0 for hidden ones and those out of view.
fn weights<T: Real>(
    parent: &Tape<T>,
    splats: &SplatVars,
    camera: &PinholeCamera,
    raster: &RasterSettings,
) -> anyhow::Result<(Tape<T>, Tensor<T>)> {
    let count = parent.value(splats.positions).rows();
    let (log_scales, rotations) = scales_and_rotations(splats);
    let mut tape = parent.child();
    let [positions, log_scales, rotations, opacity_logits] =
        [splats.positions, log_scales, rotations, splats.opacity_logits].map(|var| {
            tape.constant(parent.value(var).clone()) //
        });
    let shape = ShapeVars::ScaleRotation { log_scales, rotations };
    let sh = tape.constant(Tensor::zeros([count, 1, 3]));
    let splats = SplatVars { positions, shape, opacity_logits, sh };
    let settings = RasterSettings { sh_degree: 0, ..*raster };
    let ones = tape.leaf(Tensor::full([count, 1], T::ONE));
    let rendered = rasteriser::render(&mut tape, &splats, Some(ones), camera, &settings).map_err(too_large)?;
    let weights = rendered.features.expect("features were given");
    let seed = Tensor::full(tape.value(weights).shape(), T::ONE);
    let reached = tape.backward(&[(weights, seed)]).take(ones).unwrap_or_else(|| Tensor::zeros([count, 1]));
    let reached = tape.constant(reached);
    let [a, m] = [0, 2].map(|column| columns(&mut tape, rendered.conics, column..column + 1));
    let share = visible_share(&mut tape, reached, a, m, opacity_logits, TAU);
    let opacity = sigmoid(&mut tape, opacity_logits);
    let seen = mul(&mut tape, share, opacity);
    let both = concat_columns(&mut tape, &[seen, opacity]);
    let both = tape.value(both).clone();
    Ok((tape, both))
}

pointwise! {
    /// The weight that reached pixels over the integral of a splat's alpha, o·2π/√(a·m) for the conic (a, k, m) and the
    /// opacity o of a logit; 0 where none did, at most 1.
    fn visible_share(reached, a, m, logit) with(full_turn) -> y {
        return select(0.0, min(reached * sqrt(a * m) * (1.0 + exp(-logit)) / full_turn, 1.0), reached > 0.0);
    }
    gradients(dy) {
        reached: { return 0.0 * dy; }
        a: { return 0.0 * dy; }
        m: { return 0.0 * dy; }
        logit: { return 0.0 * dy; }
    }
}

#[cfg(test)]
mod tests {
    use shaders::rasteriser::SplatTensors;
    use shaders::tape::Device;

    use super::*;

    /// The visible shares of Gaussians on the axis of a camera at the origin, in an image of 40 × 40 pixels: one per
    /// (position, opacity).
    fn visible_shares(gaussians: &[([f64; 3], f64)]) -> Vec<f64> {
        let count = gaussians.len();
        let tensors = SplatTensors {
            positions: Tensor::from_vec([count, 3], gaussians.iter().flat_map(|(place, _)| *place).collect()),
            log_scales: Tensor::full([count, 3], 0.1_f64.ln()),
            rotations: Tensor::from_vec([count, 4], [1.0, 0.0, 0.0, 0.0].repeat(count)),
            opacity_logits: Tensor::from_vec(
                [count, 1],
                gaussians.iter().map(|&(_, o)| (o / (1.0 - o)).ln()).collect(),
            ),
            sh: Tensor::zeros([count, 1, 3]),
        };
        let camera = PinholeCamera {
            width: 40,
            height: 40,
            focal: [80.0, 80.0],
            center: [20.0, 20.0],
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
        };
        let mut tape = Tape::new(Device::Cpu);
        let vars = tensors.constants(&mut tape);
        let (_, weights) = weights(&tape, &vars, &camera, &RasterSettings::default()).unwrap();
        weights.as_slice().as_chunks::<2>().0.iter().map(|[seen, all]| seen / all).collect()
    }

    #[test]
    fn what_is_hidden_or_out_of_view_is_not_visible() {
        // Three opaque Gaussians in front of one that is smaller in the image, and one outside the image.
        let front = [2.0, 2.1, 2.2].map(|depth| ([0.0, 0.0, depth], 0.98));
        let shares = visible_shares(&[&front[..], &[([0.0, 0.0, 8.0], 0.9), ([9.0, 0.0, 4.0], 0.9)]].concat());
        assert!(shares[0] > 0.9 && shares[3] < 0.05 && shares[4] == 0.0, "{shares:?}");
        let alone = visible_shares(&[([0.0, 0.0, 8.0], 0.9)]);
        assert!(alone[0] > 0.9, "{alone:?}");
    }

    #[test]
    fn half_of_the_light_passes_a_gaussian_of_opacity_one_half() {
        // The nearer one covers the farther one with almost its whole opacity.
        let shares = visible_shares(&[([0.0, 0.0, 1.0], 0.5), ([0.0, 0.0, 20.0], 0.9)]);
        assert!((shares[1] - 0.5).abs() <= 0.05, "{shares:?}");
    }
}

//! Why splats have no image, and how often a projection kept numbers in range. Whoever trains wants to know: a guard
//! hides where arithmetic would have ended.

use super::settings::RasterSettings;
use super::{PinholeCamera, ProjectedVars};
use crate::tape::{Later, Real, Tape, Tensor};

/// Event: splats with a value that is infinite or NaN. They are not drawn; whoever trains or renders a model must ask.
pub const NOT_FINITE: &str = "splats not finite";

/// Why a splat has no image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Culled {
    /// Outside of the image, too faint to see, or beyond the far plane.
    Unseen,
    /// Before the near plane or behind the camera.
    Near,
    /// A standard deviation is out of all proportion, or the image of the splat is.
    Huge,
    /// A parameter is infinite or NaN.
    NotFinite,
}

impl Culled {
    /// Every reason, in the order of their codes.
    pub const ALL: [Self; 4] = [Self::Unseen, Self::Near, Self::Huge, Self::NotFinite];

    /// What stands for the cutoff of a culled splat: −1, −2, …
    pub fn code(self) -> f64 {
        -1.0 - f64::from(self as u8)
    }
}

/// What is counted, in the order of the kernel: splats that were culled for their numbers, and numbers that were kept in
/// range: of splats far off the axis (the affine map of the perspective is that of the image's margin), opacities above
/// what the cap of alpha allows, and colour channels below zero.
const EVENTS: [&str; 6] = [
    "splats before the near plane",
    "splats out of proportion",
    NOT_FINITE,
    "splats far off the axis",
    "opacities above the cap",
    "color channels below zero",
];

/// Counts [`EVENTS`] for the tape; on a GPU they are looked at later.
pub(super) fn count<T: Real>(
    tape: &mut Tape<T>,
    projected: &ProjectedVars,
    camera: &PinholeCamera,
    settings: &RasterSettings,
) {
    let limits = Limits { size_px: [camera.width, camera.height], alpha_cap: settings.alpha_cap };
    let ProjectedVars { means2d, opacities, colors, cutoffs, .. } = *projected;
    let values = [cutoffs, means2d, opacities, colors].map(|var| tape.value(var));
    match tape.device().gpu().filter(|_| !values[0].is_on_host()) {
        Some(gpu) => {
            let counts = super::gpu::count_guards(gpu, values, &limits);
            tape.say_later(Later::Events { names: EVENTS.to_vec(), counts });
        }
        None => {
            let counts = count_on_host(values, &limits);
            let happened = EVENTS.into_iter().zip(counts).filter(|(_, count)| *count > 0);
            happened.for_each(|(what, count)| tape.count(what, count));
        }
    }
}

/// What numbers are compared with.
pub(super) struct Limits {
    /// Width and height.
    pub size_px: [usize; 2],
    pub alpha_cap: f64,
}

fn count_on_host<T: Real>([cutoffs, means2d, opacities, colors]: [&Tensor<T>; 4], limits: &Limits) -> [u64; 6] {
    let cutoffs = cutoffs.as_slice();
    let culled = |why: Culled| cutoffs.iter().filter(|cutoff| cutoff.to_f64() == why.code()).count();
    let is_drawn = |index: usize| cutoffs[index] >= T::ZERO;
    let margin = super::reference::CLAMP_MARGIN;
    let is_off_axis = |mean: &[T; 2]| {
        (0..2).any(|axis| {
            let at = mean[axis].to_f64() / limits.size_px[axis] as f64;
            at < -margin || at > 1.0 + margin
        })
    };
    let means = means2d.as_slice().as_chunks::<2>().0.iter().enumerate();
    let off_axis = means.filter(|(index, mean)| is_drawn(*index) && is_off_axis(mean)).count();
    let capped = opacities.as_slice().iter().filter(|opacity| opacity.to_f64() > limits.alpha_cap).count();
    let colors = colors.as_slice().as_chunks::<3>().0.iter().enumerate();
    let drawn = colors.filter(|(index, _)| is_drawn(*index));
    let dark = drawn.flat_map(|(_, color)| color).filter(|channel| **channel == T::ZERO).count();
    let [near, huge, not_finite] = [Culled::Near, Culled::Huge, Culled::NotFinite].map(culled);
    [near, huge, not_finite, off_axis, capped, dark].map(|count| count as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::noise;
    use crate::gpu::conformance::Disagreement;
    use crate::gpu::fault::assert_noticed;
    use crate::gpu::tests::test_gpu;

    /// Splats with everything that is counted.
    fn guarded(count: usize) -> [Tensor<f32>; 4] {
        let random = |len: usize, scale: f64| -> Vec<f32> {
            noise(len, len as u64).into_iter().map(|value| (scale * value) as f32).collect()
        };
        let cutoff = |index: usize| [1.0, -1.0, -2.0, -3.0, -4.0, 0.0][index % 6];
        let cutoffs = Tensor::from_vec([count], (0..count).map(cutoff).collect());
        let opacities = random(count, 1.5).into_iter().map(f32::abs).collect();
        let colors = random(3 * count, 1.0).into_iter().map(|value| value.max(0.0)).collect();
        [
            cutoffs,
            Tensor::from_vec([count, 2], random(2 * count, 100.0)),
            Tensor::from_vec([count], opacities),
            Tensor::from_vec([count, 3], colors),
        ]
    }

    fn compare(count: usize) -> Result<usize, Disagreement> {
        let Some(gpu) = test_gpu() else { return Ok(0) };
        let limits = Limits { size_px: [40, 30], alpha_cap: 0.99 };
        let values = guarded(count);
        let expected = count_on_host(values.each_ref(), &limits);
        let mut found = [0_u32; 6];
        super::super::gpu::count_guards(gpu, values.each_ref(), &limits).read_into(&mut found);
        let numbers = |counts: Vec<f64>| Tensor::from_vec([6], counts);
        let found = numbers(found.map(f64::from).to_vec());
        crate::check::agree(&found, &numbers(expected.map(|count| count as f64).to_vec()), 0.0)
            .map(|()| 1)
            .map_err(|mismatch| Disagreement { what: format!("the events of {count} splats"), mismatch })
    }

    #[test]
    fn a_gpu_counts_the_same() {
        for count in [0, 1, 255, 600] {
            compare(count).unwrap_or_else(|error| panic!("{error}"));
        }
    }

    #[test]
    fn a_gpu_that_counts_otherwise_is_noticed() {
        if test_gpu().is_none() {
            return;
        }
        let kernel = "projection, guards";
        let faults = [("-4.0", "-5.0"), ("> limits.alpha_cap", "> 1.0"), ("== 0.0", "== 1.0"), ("1.0 + MARGIN", "1.0")];
        assert_noticed(&faults.map(|(right, wrong)| (kernel, right, wrong)), || compare(600));
    }
}

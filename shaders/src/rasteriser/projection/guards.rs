//! Reasons for culling, and counts of numbers that the projection kept in range. They are reported because a guard hides
//! an arithmetic failure.

use super::ProjectedVars;
use crate::geometry::camera::PinholeCamera;
use crate::rasteriser::settings::RasterSettings;
use crate::tape::{Real, Tape};

/// Event: splats with a value that is infinite or NaN. They are culled; trainer and renderer must check this count.
pub const NOT_FINITE: &str = "splats not finite";

/// Why a splat has no image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Culled {
    /// Outside the image, too faint, or beyond the far plane.
    Unseen,
    /// In front of the near plane or behind the camera.
    Near,
    /// A standard deviation or the image of the splat is extremely large.
    Huge,
    /// A parameter is infinite or NaN.
    NotFinite,
}

impl Culled {
    /// Every reason, in the order of their codes.
    pub(crate) const ALL: [Self; 4] = [Self::Unseen, Self::Near, Self::Huge, Self::NotFinite];

    /// The code stored instead of the cutoff of a culled splat: −1, −2, …
    pub(crate) fn code(self) -> f64 {
        -1.0 - f64::from(self as u8)
    }
}

/// The counted events, in the order of the kernel: splats culled by the near plane, for extreme values and for values
/// that are not finite; then values kept in range: the affine map of splats far off the axis (clamped at the image's
/// margin), opacities above the cap of alpha, and colour channels below zero.
pub(super) const EVENTS: [&str; 6] = [
    "splats in front of the near plane",
    "splats with extreme values",
    NOT_FINITE,
    "splats far off the axis",
    "opacities above the cap",
    "color channels below zero",
];

/// Counts [`EVENTS`] of a projection on the host, for the tape.
pub(super) fn count<T: Real>(
    tape: &mut Tape<T>,
    projected: &ProjectedVars,
    camera: &PinholeCamera,
    settings: &RasterSettings,
) {
    let ProjectedVars { means2d, opacities, colors, cutoffs, .. } = *projected;
    let [cutoffs, means2d, opacities, colors] =
        [cutoffs, means2d, opacities, colors].map(|var| tape.value(var).as_slice());
    let culled = |why: Culled| cutoffs.iter().filter(|cutoff| cutoff.to_f64() == why.code()).count();
    let is_drawn = |index: usize| cutoffs[index] >= T::ZERO;
    let margin = super::CLAMP_MARGIN;
    let size_px = [camera.width as f64, camera.height as f64];
    let is_off_axis = |mean: &[T; 2]| {
        (0..2).any(|axis| {
            let at = mean[axis].to_f64() / size_px[axis];
            at < -margin || at > 1.0 + margin
        })
    };
    let means = means2d.as_chunks::<2>().0.iter().enumerate();
    let off_axis = means.filter(|(index, mean)| is_drawn(*index) && is_off_axis(mean)).count();
    let capped = opacities.iter().filter(|opacity| opacity.to_f64() > settings.alpha_cap).count();
    let drawn = colors.as_chunks::<3>().0.iter().enumerate().filter(|(index, _)| is_drawn(*index));
    let dark = drawn.flat_map(|(_, color)| color).filter(|channel| **channel == T::ZERO).count();
    let [near, huge, not_finite] = [Culled::Near, Culled::Huge, Culled::NotFinite].map(culled);
    let counts = [near, huge, not_finite, off_axis, capped, dark];
    for (what, count) in EVENTS.into_iter().zip(counts).filter(|(_, count)| *count > 0) {
        tape.count(what, count as u64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::conformance::Disagreement;
    use crate::check::noise;
    use crate::gpu::fault_tests::assert_noticed;
    use crate::gpu::tests::test_gpu;
    use crate::rasteriser::projection::project;
    use crate::rasteriser::splats::{HIDDEN_LOGIT, SplatTensors};
    use crate::tape::{Device, Tensor};

    /// Splats around a camera that trigger every counted event.
    fn guarded(count: usize) -> SplatTensors<f32> {
        let random = |columns: usize, seed: u64, scale: f64, offset: f64| {
            let values = noise(columns * count, seed).into_iter().map(|value| offset + scale * value);
            Tensor::from_vec([count, columns], values.collect()).cast::<f32>()
        };
        let mut splats = SplatTensors {
            positions: random(3, 1, 3.0, 0.0),
            log_scales: random(3, 2, 1.0, -1.0),
            rotations: random(4, 3, 1.0, 0.0),
            opacity_logits: random(1, 4, 8.0, 0.0),
            sh: random(3, 5, 3.0, 0.0).reshape([count, 1, 3]),
        };
        (0..count).step_by(7).for_each(|splat| splats.log_scales.make_mut()[3 * splat] = 60.0);
        (0..count).step_by(11).for_each(|splat| splats.opacity_logits.make_mut()[splat] = f32::NAN);
        splats
    }

    /// The counts of all events.
    fn events(device: Device, count: usize) -> [u64; 6] {
        events_of(device, guarded(count))
    }

    fn events_of(device: Device, splats: SplatTensors<f32>) -> [u64; 6] {
        let camera = PinholeCamera {
            width: 40,
            height: 30,
            focal: [30.0; 2],
            center: [20.0, 15.0],
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
        };
        let mut tape = Tape::new(device);
        let vars = splats.constants(&mut tape);
        project(&mut tape, &vars, &camera, &RasterSettings { sh_degree: 0, ..RasterSettings::default() });
        tape.read_back();
        EVENTS.map(|event| tape.profile().events.get(event).copied().unwrap_or(0))
    }

    fn compare(count: usize) -> Result<usize, Disagreement> {
        let Some(gpu) = test_gpu() else { return Ok(0) };
        let numbers = |device| Tensor::from_vec([6], events(device, count).map(|count| count as f64).to_vec());
        crate::check::agree(&numbers(Device::Gpu(gpu)), &numbers(Device::Cpu), 0.0)
            .map(|()| 1)
            .map_err(|mismatch| Disagreement { what: format!("the events of {count} splats"), mismatch })
    }

    #[test]
    fn a_gpu_counts_the_same() {
        assert!(events(Device::Cpu, 600).iter().all(|&count| count > 5), "{:?}", events(Device::Cpu, 600));
        for count in [0, 1, 63, 65, 600] {
            compare(count).unwrap_or_else(|error| panic!("{error}"));
        }
    }

    #[test]
    fn hidden_splats_are_not_counted() {
        for device in [Some(Device::Cpu), test_gpu().map(Device::Gpu)].into_iter().flatten() {
            let hidden = SplatTensors { opacity_logits: Tensor::full([300, 1], HIDDEN_LOGIT as f32), ..guarded(300) };
            assert_eq!(events_of(device, hidden), [0; 6]);
        }
    }

    #[test]
    fn a_gpu_that_counts_otherwise_is_noticed() {
        if test_gpu().is_none() {
            return;
        }
        let faults = [
            ("why == NEAR", "why == UNSEEN"),
            ("why == NOT_FINITE", "why == HUGE"),
            ("> view.alpha_cap", "> 1.0"),
            ("dark.x + dark.y", "dark.x"),
            ("1.0 + MARGIN", "1.0"),
        ];
        assert_noticed(&faults.map(|(right, wrong)| ("projection", right, wrong)), || compare(600));
    }
}

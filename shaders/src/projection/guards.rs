//! Why splats have no image, and how often a projection kept numbers in range. Whoever trains wants to know: a guard
//! hides where arithmetic would have ended.

use super::settings::RasterSettings;
use super::{PinholeCamera, ProjectedVars};
use crate::tape::{Real, Tape};

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

    /// The event under which such splats are counted, if anybody wants to know.
    fn event(self) -> Option<&'static str> {
        match self {
            Self::Unseen => None,
            Self::Near => Some("splats before the near plane"),
            Self::Huge => Some("splats out of proportion"),
            Self::NotFinite => Some(NOT_FINITE),
        }
    }
}

/// Counts, as events of the tape, the splats that were culled for their numbers and those whose numbers were kept in
/// range: far off the axis (the affine map of the perspective is that of the image's margin), brighter than the cap of
/// alpha allows, and colour channels below zero.
pub(super) fn count<T: Real>(
    tape: &mut Tape<T>,
    projected: &ProjectedVars,
    camera: &PinholeCamera,
    settings: &RasterSettings,
) {
    let cutoffs = tape.value(projected.cutoffs).as_slice();
    let mut found: Vec<(&'static str, u64)> = Vec::new();
    for why in Culled::ALL {
        let count = cutoffs.iter().filter(|cutoff| cutoff.to_f64() == why.code()).count();
        found.extend(why.event().map(|event| (event, count as u64)));
    }
    let is_drawn = |index: usize| cutoffs[index] >= T::ZERO;
    let margin = super::reference::CLAMP_MARGIN;
    let size = [camera.width as f64, camera.height as f64];
    let is_off_axis = |mean: &[T; 2]| {
        (0..2).any(|axis| {
            let at = mean[axis].to_f64() / size[axis];
            at < -margin || at > 1.0 + margin
        })
    };
    let means = tape.value(projected.means2d).as_slice().as_chunks::<2>().0.iter().enumerate();
    let off_axis = means.filter(|(index, mean)| is_drawn(*index) && is_off_axis(mean)).count();
    let opacities = tape.value(projected.opacities).as_slice().iter();
    let capped = opacities.filter(|opacity| opacity.to_f64() > settings.alpha_cap).count();
    let colors = tape.value(projected.colors).as_slice().as_chunks::<3>().0.iter().enumerate();
    let drawn = colors.filter(|(index, _)| is_drawn(*index));
    let dark = drawn.flat_map(|(_, color)| color).filter(|channel| **channel == T::ZERO).count();
    found.extend([
        ("splats far off the axis", off_axis as u64),
        ("opacities above the cap", capped as u64),
        ("color channels below zero", dark as u64),
    ]);
    found.into_iter().filter(|(_, count)| *count > 0).for_each(|(what, count)| tape.count(what, count));
}

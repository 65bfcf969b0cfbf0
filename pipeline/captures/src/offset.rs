//! Whether the files of views fit other frames better than their own.

use engine::JobContext;
use scene::{Capture, Videos};

/// Maximum number of views that are checked.
const CHECKED: usize = 12;
/// Minimum number of views that must agree on a shift, so that one bad file is not mistaken for a shift.
const MIN_CHECKED: usize = 3;
/// The sum of the errors with the shift must be below this share of the sum without it.
const BETTER: f64 = 0.8;
/// Share of the checked views whose error the shift must reduce.
const MAJORITY: f64 = 0.75;

/// The shift by one frame, −1 or 1, with which files fit the views clearly better; `None` if there is no such shift, or
/// too few views can be checked. `error(view, file)` is the misfit of the file of one view with another view, both as
/// indices in the capture, if it is known.
pub fn better_shift(
    capture: &Capture,
    error: impl Fn(usize, usize) -> anyhow::Result<Option<f64>>,
) -> anyhow::Result<Option<i64>> {
    let videos = Videos::of(capture);
    let count = capture.views.len();
    let candidates: Vec<usize> = (0..count).step_by(count.div_ceil(CHECKED).max(1)).collect();
    for shift in [-1, 1] {
        let (mut checked, mut better, mut own_sum, mut shifted_sum) = (0, 0, 0.0, 0.0);
        for &view in &candidates {
            let Some(other) = videos.after(&capture.views[view], shift) else { continue };
            let (Some(own), Some(shifted)) = (error(view, view)?, error(view, other)?) else { continue };
            checked += 1;
            better += usize::from(shifted < own);
            (own_sum, shifted_sum) = (own_sum + own, shifted_sum + shifted);
        }
        let is_consistent = checked >= MIN_CHECKED && better as f64 >= MAJORITY * checked as f64;
        if is_consistent && shifted_sum < BETTER * own_sum {
            return Ok(Some(shift));
        }
    }
    Ok(None)
}

/// Records a shift found by [`better_shift`] as `measurement`, and warns of it. `fit` names the files and what they are compared
/// with, e.g. "depth files fit the points".
pub fn record_shift(context: &JobContext, measurement: &str, fit: &str, shift: Option<i64>) -> anyhow::Result<()> {
    context.measure(measurement, shift)?;
    if let Some(shift) = shift {
        tracing::warn!("{}", message(fit, shift));
    }
    Ok(())
}

fn message(fit: &str, shift: i64) -> String {
    let neighbor = if shift < 0 { "before" } else { "after" };
    format!(
        "the {fit} better if every view takes the file of the frame {neighbor} it: is the first number that of the first frame? \
         Rename the files, or see `naming`"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_message_names_the_frame_whose_file_fits() {
        let of = |shift: i64| message("masks fit the images", shift);
        assert!(
            of(-1).starts_with("the masks fit the images better if every view takes the file of the frame before it")
        );
        assert!(of(1).contains("the frame after it"));
    }
}

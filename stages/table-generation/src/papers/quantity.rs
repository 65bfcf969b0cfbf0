//! The quantities that printed cells measure.

use metric_evaluation::{MaskName, Metric};
use serde::Deserialize;

use crate::column::{Column, Masked};

/// The quantity that a printed cell measures, in the unit of the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Quantity {
    /// PSNR, dB.
    Psnr,
    /// SSIM of an unstated variant.
    Ssim,
    /// Multi-scale SSIM.
    MsSsim,
    /// LPIPS of an unstated network and input range.
    Lpips,
    /// PSNR over the pixels of a mask, dB.
    MaskedPsnr,
    /// SSIM over the pixels of a mask.
    MaskedSsim,
    /// LPIPS over the pixels of a mask.
    MaskedLpips,
    /// Minutes of training.
    TrainMin,
    /// Frames per second, by the paper's own definition.
    Fps,
    /// Thousands of Gaussians.
    GaussiansK,
    /// Size of the model, MB.
    SizeMb,
    /// A VBench score: networks judge videos.
    Vbench,
}

/// Whether a cell holds no number: it is empty, a bound, or a unit alone.
pub(crate) fn is_blank(text: &str) -> bool {
    matches!(text, "" | "-" | "N/A" | "~h") || text.starts_with('<')
}

impl Quantity {
    /// The printed number; none for a blank cell and for a text that is not a number.
    pub(crate) fn value(self, text: &str) -> Option<f64> {
        if is_blank(text) {
            return None;
        }
        match self {
            Self::TrainMin => minutes(text),
            Self::GaussiansK => text.strip_suffix('k')?.parse().ok(),
            _ => text.parse().ok(),
        }
    }

    /// Whether the quantity is over the pixels of a mask, which the table has to name.
    pub(crate) fn is_masked(self) -> bool {
        matches!(self, Self::MaskedPsnr | Self::MaskedSsim | Self::MaskedLpips)
    }

    /// The matching column, and the divisor that converts its values to the paper's unit; none if this project does
    /// not measure the quantity, and for a masked quantity without a mask.
    pub(crate) fn measured_as(self, mask: Option<MaskName>) -> Option<(Column, f64)> {
        let metric = |metric: Metric| Some((Column::Metric(metric), 1.0));
        let masked = |metric: Metric| Some((Column::Masked(Masked { metric, mask: mask? }), 1.0));
        match self {
            Self::Psnr => Some((Column::PSNR, 1.0)),
            Self::Ssim => metric(Metric::Ssim),
            Self::MsSsim => metric(Metric::MsSsim),
            Self::Lpips => metric(Metric::LpipsVgg),
            Self::MaskedPsnr => masked(Metric::MaskedPsnr),
            Self::MaskedSsim => masked(Metric::MaskedSsim),
            Self::MaskedLpips => masked(Metric::MaskedLpips),
            Self::TrainMin => Some((Column::TrainingSecs, 60.0)),
            Self::Fps => Some((Column::FpsModel, 1.0)),
            Self::GaussiansK => Some((Column::Gaussians, 1e3)),
            Self::SizeMb => Some((Column::SizeMb, 1.0)),
            Self::Vbench => None,
        }
    }

    /// The variant of LPIPS that [`Self::measured_as`] takes; none for other quantities. Papers seldom state theirs.
    pub(crate) fn variant(self) -> Option<&'static str> {
        match self {
            Self::Lpips => Some(
                "Measured LPIPS: VGG, input in [-1, 1]. The published code of 3DGS and 4DGaussians feeds [0, 1], which gives \
                 lower values: columns `lpips_vgg_legacy` and `lpips_alex_legacy`.",
            ),
            Self::MaskedLpips => Some("Measured LPIPS over a mask: AlexNet, input in [-1, 1]."),
            _ => None,
        }
    }

    /// Decimals of the measured value next to the printed one.
    pub(crate) fn decimals(self) -> usize {
        match self {
            Self::Psnr | Self::MaskedPsnr | Self::TrainMin | Self::GaussiansK | Self::SizeMb => 2,
            Self::Fps => 1,
            Self::Ssim | Self::MsSsim | Self::MaskedSsim | Self::Lpips | Self::MaskedLpips | Self::Vbench => 3,
        }
    }

    /// Whether a difference in dB decides about reproduction. The other quantities have no verdict: papers do not state
    /// their variants of SSIM and LPIPS, and seconds and frame rates depend on the machine.
    pub(crate) fn has_verdict(self) -> bool {
        matches!(self, Self::Psnr | Self::MaskedPsnr)
    }
}

/// Parses `79 min`, `30 mins`, `1344 h`, `1.27 hour` or `15:19` (minutes and seconds) as minutes.
fn minutes(text: &str) -> Option<f64> {
    if let Some((minutes, seconds)) = text.split_once(':') {
        return Some(minutes.parse::<f64>().ok()? + seconds.parse::<f64>().ok()? / 60.0);
    }
    let number: f64 = text.trim_end_matches(|c: char| c.is_ascii_alphabetic()).trim().parse().ok()?;
    let unit = text.trim_start_matches(|c: char| !c.is_ascii_alphabetic());
    match unit {
        "min" | "mins" => Some(number),
        "h" | "hour" | "hours" => Some(60.0 * number),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn printed_cells_are_parsed_with_units() {
        let minutes = |text| Quantity::TrainMin.value(text);
        assert_eq!(["79 min", "30 mins", "5.5 hours", "1.5 h"].map(minutes), [79.0, 30.0, 330.0, 90.0].map(Some));
        assert!(minutes("15:19").is_some_and(|value| (value - 15.3167).abs() <= 1e-3));
        assert_eq!([minutes("-"), minutes("~h"), minutes("soon")], [None; 3]);
        assert_eq!(Quantity::GaussiansK.value("81.30k"), Some(81.3));
        assert_eq!((Quantity::Lpips.value(".474"), Quantity::Fps.value("<1.20")), (Some(0.474), None));
        assert!(is_blank("<1.20") && !is_blank("soon"));
    }
}

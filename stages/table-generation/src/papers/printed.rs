//! What printed cells mean.

use metric_evaluation::Metric;
use serde::Deserialize;

use crate::Column;

/// What a printed cell measures, in the unit in which its value is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Figure {
    /// PSNR, dB.
    Psnr,
    /// SSIM of a variant that is not stated.
    Ssim,
    /// Multi-scale SSIM.
    MsSsim,
    /// LPIPS of a network and input range that are not stated.
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
    /// Megabytes of the model.
    SizeMb,
    /// A score of VBench, which judges videos by networks.
    Vbench,
}

/// Printed where there is no number: nothing, a bound, or a unit without one.
pub fn says_no_number(text: &str) -> bool {
    matches!(text, "" | "-" | "N/A" | "~h") || text.starts_with('<')
}

impl Figure {
    /// The number that is printed; none where the cell holds none, or a bound.
    pub fn value(self, text: &str) -> Option<f64> {
        if says_no_number(text) {
            return None;
        }
        match self {
            Self::TrainMin => minutes(text),
            Self::GaussiansK => text.strip_suffix('k')?.parse().ok(),
            _ => text.parse().ok(),
        }
    }

    /// Our figure, and what it is divided by to get to the paper's unit; none where we have no such figure.
    pub fn measured_as(self) -> Option<(Column, f64)> {
        let metric = |keys: &[&str]| {
            let known = keys.iter().find_map(|key| Metric::ALL.into_iter().find(|metric| metric.key() == *key))?;
            Some((Column::Metric(known), 1.0))
        };
        match self {
            Self::Psnr => Some((Column::PSNR, 1.0)),
            Self::Ssim => metric(&["ssim"]),
            Self::MsSsim => metric(&["ms_ssim"]),
            Self::Lpips => metric(&["lpips_vgg", "lpips_alex"]),
            Self::MaskedPsnr => metric(&["masked_psnr"]),
            Self::MaskedSsim => metric(&["masked_ssim"]),
            Self::MaskedLpips => metric(&["masked_lpips"]),
            Self::TrainMin => Some((Column::TrainingSecs, 60.0)),
            Self::Fps => Some((Column::FpsModel, 1.0)),
            Self::GaussiansK => Some((Column::Gaussians, 1e3)),
            Self::SizeMb => Some((Column::SizeMb, 1.0)),
            Self::Vbench => None,
        }
    }

    /// Decimals of our figure beside the printed one.
    pub fn decimals(self) -> usize {
        match self {
            Self::Psnr | Self::MaskedPsnr | Self::TrainMin | Self::GaussiansK | Self::SizeMb => 2,
            Self::Fps => 1,
            Self::Ssim | Self::MsSsim | Self::MaskedSsim | Self::Lpips | Self::MaskedLpips | Self::Vbench => 3,
        }
    }

    /// Whether a difference in dB decides about reproduction. Variants of SSIM and LPIPS are not stated, and seconds
    /// and frame rates belong to a machine: those stand side by side without a verdict.
    pub fn has_verdict(self) -> bool {
        matches!(self, Self::Psnr | Self::MaskedPsnr)
    }
}

/// `79 min`, `30 mins`, `1344 h`, `1.27 hour`, `15:19` (minutes and seconds), or hours where there is no unit.
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
    fn printed_cells_are_read_with_their_units() {
        let minutes = |text| Figure::TrainMin.value(text);
        assert_eq!(["79 min", "30 mins", "5.5 hours", "1.5 h"].map(minutes), [79.0, 30.0, 330.0, 90.0].map(Some));
        assert!(minutes("15:19").is_some_and(|value| (value - 15.3167).abs() <= 1e-3));
        assert_eq!([minutes("-"), minutes("~h"), minutes("soon")], [None; 3]);
        assert_eq!(Figure::GaussiansK.value("81.30k"), Some(81.3));
        assert_eq!((Figure::Lpips.value(".474"), Figure::Fps.value("<1.20")), (Some(0.474), None));
        assert!(says_no_number("<1.20") && !says_no_number("soon"));
    }
}

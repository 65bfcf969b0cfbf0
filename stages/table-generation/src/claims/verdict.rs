//! Verdicts: whether a measurement reproduces a published value.

use serde::{Deserialize, Serialize};

use crate::cell::Cell;
use crate::format::signed;
use crate::statistics::half_width;

/// Result of the comparison of a measured with a published PSNR.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "verdict", rename_all = "kebab-case")]
pub(crate) enum Verdict {
    /// The difference is within the tolerance.
    Reproduced {
        /// Measured minus published, dB.
        delta_db: f64,
    },
    /// Undecided: the difference exceeds the tolerance, but the published value lies in the 95 % interval of the measured
    /// mean, which is therefore wider than the tolerance.
    WithinSpread {
        /// Measured minus published, dB.
        delta_db: f64,
    },
    /// The measured value is lower by more than tolerance and interval.
    Below {
        /// Measured minus published, dB.
        delta_db: f64,
    },
    /// The measured value is higher by more than tolerance and interval.
    Above {
        /// Measured minus published, dB.
        delta_db: f64,
    },
    /// The protocols differ, or the source does not fully state its own.
    NotComparable,
    /// No value was measured.
    NotMeasured,
}

impl Verdict {
    /// Whether measured and published value were compared.
    pub(crate) fn is_judged(&self) -> bool {
        !matches!(self, Self::NotComparable | Self::NotMeasured)
    }

    /// Whether the measured value reproduces the published one. A wide interval that contains it does not count: fewer
    /// seeds and more noise would reproduce more values.
    pub(crate) fn is_reproduced(&self) -> bool {
        matches!(self, Self::Reproduced { .. })
    }

    /// Whether the measured mean is too imprecise to decide.
    pub(crate) fn is_undecided(&self) -> bool {
        matches!(self, Self::WithinSpread { .. })
    }

    /// The verdict on a published value (dB); `differences` are those between the protocols.
    pub(crate) fn new(published: f64, measured: &Cell, differences: &[String], tolerance_db: f64) -> Self {
        let Some(mean) = measured.mean else { return Self::NotMeasured };
        if !differences.is_empty() {
            return Self::NotComparable;
        }
        let spread_db = measured.std.and_then(|std| half_width(std, measured.n())).unwrap_or(0.0);
        Self::of(mean - published, tolerance_db, spread_db)
    }

    fn of(delta_db: f64, tolerance_db: f64, spread_db: f64) -> Self {
        // Published values have two decimals, so the difference is rounded to two before it is compared: 0.304 counts
        // as 0.30, which is within 0.3.
        let rounded = (delta_db * 100.0).round() / 100.0;
        if rounded.abs() <= tolerance_db {
            Self::Reproduced { delta_db }
        } else if delta_db.abs() <= spread_db {
            Self::WithinSpread { delta_db }
        } else if delta_db < 0.0 {
            Self::Below { delta_db }
        } else {
            Self::Above { delta_db }
        }
    }

    /// The verdict in words, with the difference in dB where values were compared.
    pub(crate) fn text(&self) -> String {
        match self {
            Self::Reproduced { delta_db } => format!("reproduced ({})", signed(*delta_db, 2)),
            Self::WithinSpread { delta_db } => format!("within spread ({})", signed(*delta_db, 2)),
            Self::Below { delta_db } => format!("measured below ({})", signed(*delta_db, 2)),
            Self::Above { delta_db } => format!("measured above ({})", signed(*delta_db, 2)),
            Self::NotComparable => "not comparable".into(),
            Self::NotMeasured => "not measured".into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_rounded_to_two_decimals() {
        assert!(matches!(Verdict::of(0.3, 0.3, 0.0), Verdict::Reproduced { .. }));
        assert!(matches!(Verdict::of(-0.304, 0.3, 0.0), Verdict::Reproduced { .. }));
        assert!(matches!(Verdict::of(-0.306, 0.3, 0.0), Verdict::Below { .. }));
        assert!(matches!(Verdict::of(0.306, 0.3, 0.0), Verdict::Above { .. }));
    }

    #[test]
    fn spread_leaves_a_difference_undecided_only_with_several_seeds() {
        let cell = |values: &[f64], std| Cell { mean: Some(30.0), std, values: values.into(), ..Cell::default() };
        // Standard deviation 0.5 dB over three seeds: half the interval is 4.303 · 0.5 / √3 = 1.24 dB.
        let spread = cell(&[29.5, 30.0, 30.5], Some(0.5));
        let verdict = |published| Verdict::new(published, &spread, &[], 0.3);
        assert!(matches!(verdict(31.2), Verdict::WithinSpread { .. }));
        assert!(verdict(31.2).is_undecided() && !verdict(31.2).is_reproduced(), "noise reproduces nothing");
        assert!(matches!(verdict(31.3), Verdict::Below { .. }));
        assert!(matches!(Verdict::new(31.2, &cell(&[30.0], None), &[], 0.3), Verdict::Below { .. }));
        assert_eq!(Verdict::new(30.0, &spread, &["other images".into()], 0.3), Verdict::NotComparable);
        assert_eq!(Verdict::new(30.0, &Cell::default(), &[], 0.3), Verdict::NotMeasured);
    }
}

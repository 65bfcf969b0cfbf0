//! The goal of a search: an objective, and limits that no trial may violate.

use std::fmt;
use std::str::FromStr;

use table_generation::{Column, number};

/// The values that a training measures itself; all others need renders of the validation views and a table.
const OF_TRAINING: [Column; 2] = [Column::PsnrAtEnd, Column::TrainingSecs];

/// The objective of a search, with its limits.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Goal {
    /// The column that trials are compared by, in its own direction.
    pub(crate) objective: Column,
    /// The limits that no trial may violate.
    pub(crate) limits: Vec<Limit>,
}

/// A limit on the mean of a column over all trainings of a trial.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Limit {
    pub(crate) column: Column,
    is_upper: bool,
    value: f64,
}

impl Goal {
    /// All columns that the search reads.
    pub(crate) fn columns(&self) -> impl Iterator<Item = Column> + '_ {
        [self.objective].into_iter().chain(self.limits.iter().map(|limit| limit.column))
    }

    /// Whether completed trials are rendered on validation views and put into a table.
    pub(crate) fn needs_table(&self) -> bool {
        self.columns().any(|column| !OF_TRAINING.contains(&column))
    }

    /// The column by which trials are compared at a rung: before the end, only the training's own values are known.
    pub(crate) fn compared_by(&self, is_completed: bool) -> Column {
        if is_completed || OF_TRAINING.contains(&self.objective) { self.objective } else { Column::PsnrAtEnd }
    }

    /// Converts a value of the objective's column to a score (higher is better); its own inverse.
    pub(crate) fn score(column: Column, value: f64) -> f64 {
        if column.higher_is_better() { value } else { -value }
    }

    /// The objective's name with its unit.
    pub(crate) fn heading(&self) -> String {
        match self.objective {
            Column::PsnrAtEnd => "PSNR (dB)".into(),
            column => column.heading(),
        }
    }

    /// A value of a column with its unit, e.g. `24.31 dB`.
    pub(crate) fn text(column: Column, value: f64) -> String {
        let heading = column.heading();
        let unit = heading.rsplit_once(" (").and_then(|(_, unit)| unit.strip_suffix(')'));
        let name = if unit.is_none() { format!("{} ", column.key()) } else { String::new() };
        format!("{name}{}{}", number(value, column.decimals()), unit.map(|unit| format!(" {unit}")).unwrap_or_default())
    }
}

impl Limit {
    /// Whether a value breaks the limit; NaN does.
    pub(crate) fn is_broken_by(&self, value: f64) -> bool {
        if self.is_upper { !(value <= self.value) } else { !(value >= self.value) }
    }

    /// Whether a trial that violates the limit at a rung also violates it at its end.
    pub(crate) fn only_gets_worse(&self) -> bool {
        self.is_upper && self.column == Column::TrainingSecs
    }

    /// Whether this limit takes the place of another one.
    pub(crate) fn replaces(&self, other: &Self) -> bool {
        (self.column, self.is_upper) == (other.column, other.is_upper)
    }
}

impl FromStr for Limit {
    type Err = String;

    /// Parses `COLUMN<=VALUE` or `COLUMN>=VALUE`.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("expected COLUMN<=VALUE or COLUMN>=VALUE, e.g. gaussians<=20000, not {text}");
        let (column, value, is_upper) = match (text.split_once("<="), text.split_once(">=")) {
            (Some((column, value)), None) => (column, value, true),
            (None, Some((column, value))) => (column, value, false),
            _ => return Err(wrong()),
        };
        let value = value.trim().parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(wrong)?;
        Ok(Self { column: Column::named(column.trim())?, is_upper, value })
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}{}", self.column.key(), if self.is_upper { "<=" } else { ">=" }, self.value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_have_a_side_and_nan_breaks_them() {
        let limit = |text: &str| text.parse::<Limit>();
        let upper = limit("gaussians <= 2e4").unwrap();
        assert!(upper.is_broken_by(20_001.0) && upper.is_broken_by(f64::NAN) && !upper.is_broken_by(2e4));
        let lower = limit("psnr>=28").unwrap();
        assert!(lower.is_broken_by(27.9) && lower.is_broken_by(f64::NAN) && !lower.is_broken_by(28.0));
        assert_eq!((upper.to_string().as_str(), lower.to_string().as_str()), ("gaussians<=20000", "psnr>=28"));
        assert!(limit("training_secs<=9").unwrap().only_gets_worse() && !upper.only_gets_worse());
        for wrong in ["", "gaussians", "gaussians<5", "gaussians<=", "gaussians<=x", "gaussian<=5", "psnr<=1>=2"] {
            assert!(limit(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn scores_follow_the_direction_of_the_column() {
        let goal = |objective: &str| Goal { objective: Column::named(objective).unwrap(), limits: Vec::new() };
        let better = |objective: &str, good: f64, bad: f64| {
            let column = goal(objective).objective;
            Goal::score(column, good) > Goal::score(column, bad)
        };
        assert!(better("ssim", 0.9, 0.8) && better("lpips_alex", 0.1, 0.2) && better("training_secs", 3.0, 4.0));
        assert!(!goal("training_secs").needs_table() && goal("ssim").needs_table());
        assert_eq!(goal("ssim").compared_by(false), Column::PsnrAtEnd);
        assert_eq!(goal("training_secs").compared_by(false), Column::TrainingSecs);
        assert_eq!(Goal::text(Column::PsnrAtEnd, 24.314), "24.31 dB");
        assert_eq!(Goal::text(goal("ssim").objective, 0.91234), "ssim 0.9123");
    }
}

//! Allowed differences between two values of a metric.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use table_generation::Column;

/// An absolute or relative difference.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "Written", into = "Written")]
pub(crate) enum Amount {
    /// A difference in the metric's unit.
    Absolute(f64),
    /// A percentage of the reference value's magnitude.
    Percent(f64),
}

/// The form in files: a number, or text (e.g. `2%`).
#[derive(Deserialize, Serialize)]
#[serde(untagged, expecting = "expected a non-negative number (e.g. 0.1) or text (e.g. \"2%\")")]
enum Written {
    Whole(i64),
    Number(f64),
    Text(String),
}

impl Amount {
    /// The difference allowed from `reference`, in the metric's unit.
    pub(crate) fn of(self, reference: f64) -> f64 {
        match self {
            Self::Absolute(value) => value,
            Self::Percent(percent) => percent / 100.0 * reference.abs(),
        }
    }
}

impl FromStr for Amount {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (number, make): (&str, fn(f64) -> Self) = match text.strip_suffix('%') {
            Some(number) => (number, Self::Percent),
            None => (text.strip_suffix("dB").unwrap_or(text), Self::Absolute),
        };
        let value = number.trim().parse::<f64>().ok().filter(|value| value.is_finite() && *value >= 0.0);
        value.map(make).ok_or_else(|| format!("expected a non-negative number (e.g. 0.1 or 2%), not {text}"))
    }
}

impl fmt::Display for Amount {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absolute(value) => write!(f, "{value}"),
            Self::Percent(percent) => write!(f, "{percent}%"),
        }
    }
}

impl TryFrom<Written> for Amount {
    type Error = String;

    fn try_from(written: Written) -> Result<Self, String> {
        match written {
            Written::Whole(value) => value.to_string().parse(),
            Written::Number(value) => value.to_string().parse(),
            Written::Text(text) => text.parse(),
        }
    }
}

impl From<Amount> for Written {
    fn from(amount: Amount) -> Self {
        match amount {
            Amount::Absolute(value) => Self::Number(value),
            Amount::Percent(_) => Self::Text(amount.to_string()),
        }
    }
}

/// Parses `METRIC=AMOUNT`. An amount in dB alone (e.g. `0.1dB`) applies to PSNR.
pub(crate) fn parse_limit(text: &str) -> Result<(Column, Amount), String> {
    match text.split_once('=') {
        Some((metric, amount)) => Ok((Column::named(metric)?, amount.parse()?)),
        None if text.ends_with("dB") => Ok((Column::PSNR, text.parse()?)),
        None => Err(format!("expected METRIC=AMOUNT (e.g. 0.1dB, ssim=0.01 or training_secs=20%), not {text}")),
    }
}

#[cfg(test)]
mod tests {
    use metric_evaluation::Metric;

    use super::*;

    #[test]
    fn amounts_survive_writing_and_reading() {
        for (text, amount, of_minus_40) in [
            ("0.25", Amount::Absolute(0.25), 0.25),
            ("0.1dB", Amount::Absolute(0.1), 0.1),
            ("5%", Amount::Percent(5.0), 2.0),
        ] {
            let read: Amount = text.parse().unwrap();
            assert_eq!((read, read.of(-40.0)), (amount, of_minus_40), "{text}");
            let json = serde_json::to_string(&read).unwrap();
            assert_eq!(serde_json::from_str::<Amount>(&json).unwrap(), amount, "{json}");
        }
        for wrong in ["", "-1", "nan", "inf", "2%%", "much"] {
            assert!(wrong.parse::<Amount>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn limits_name_their_metric() {
        assert_eq!(parse_limit("ssim=0.01").unwrap(), (Column::Metric(Metric::Ssim), Amount::Absolute(0.01)));
        assert_eq!(parse_limit("0.1dB").unwrap(), (Column::PSNR, Amount::Absolute(0.1)));
        assert_eq!(parse_limit("training_secs=20%").unwrap(), (Column::TrainingSecs, Amount::Percent(20.0)));
        assert!(parse_limit("0.1").is_err(), "the metric is missing");
        let unknown = parse_limit("psnrr=1").unwrap_err();
        assert!(unknown.starts_with("no column is called `psnrr`; did you mean `psnr`?"), "{unknown}");
        assert!(unknown.contains("psnr_pooled"), "{unknown}");
    }
}

//! Types and parsers of single options.

use std::convert::Infallible;
use std::path::PathBuf;
use std::time::Duration;

use clap::ValueEnum;
use clap::builder::{PathBufValueParser, PossibleValuesParser, TypedValueParser};
use jiff::Zoned;
use jiff::civil::Time;
use metric_evaluation::Background;
use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::Error as ValueError;
use sfm_import::Format;

/// Maximum number of seeds of `--replicates`; larger numbers are probably typing errors.
const MAX_REPLICATES: usize = 1000;

/// Maximum number of files that `--times` may write into one folder; larger numbers are probably typing errors. An hour
/// at 25 frames per second is 90,000.
const MAX_TIMES: usize = 100_000;

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(crate) enum GraphFormat {
    /// Graphviz
    #[default]
    Dot,
    /// Mermaid, which Markdown pages render
    Mermaid,
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(crate) enum TableFormat {
    /// Markdown
    #[default]
    Md,
    /// LaTeX
    Latex,
    /// Comma-separated values, not rounded
    Csv,
    /// JSON, not rounded, with the action key of every cell
    Json,
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(crate) enum ExportFormat {
    /// One PLY file of Gaussians per time, readable by common viewers
    #[default]
    PlySeq,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum BatchSystem {
    /// Slurm
    Slurm,
}

/// Times in seconds.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Times(pub(crate) Vec<f64>);

/// Parses the name of a capture's format, e.g. `colmap`.
pub(crate) fn capture_format(text: &str) -> Result<Format, String> {
    Format::deserialize(text.into_deserializer()).map_err(|error: ValueError| error.to_string())
}

/// Parses the colour of a background: `white` or `black`.
pub(crate) fn background() -> impl TypedValueParser<Value = Background> {
    let of_name = |name: String| if name == "white" { Background::White } else { Background::Black };
    PossibleValuesParser::new(["white", "black"]).map(of_name)
}

/// Parses `FIRST:LAST:COUNT`: evenly spaced times that include both ends.
pub(crate) fn parse_times(text: &str) -> Result<Times, String> {
    let wrong = || format!("expected FIRST:LAST:COUNT (e.g. 0:1:30), not {text}");
    let [first, last, count] = text.split(':').collect::<Vec<_>>()[..] else { return Err(wrong()) };
    let number = |text: &str| text.parse::<f64>().ok().filter(|value| value.is_finite()).ok_or_else(wrong);
    let (first, last) = (number(first)?, number(last)?);
    let count: usize = count.parse().ok().filter(|&count| count > 0).ok_or_else(wrong)?;
    if count > MAX_TIMES {
        return Err(format!("at most {MAX_TIMES} times, not {count}"));
    }
    if count == 1 && first != last {
        return Err(format!("one time cannot include both ends: write {first}:{first}:1, or a larger COUNT"));
    }
    let step = if count > 1 { (last - first) / (count - 1) as f64 } else { 0.0 };
    Ok(Times((0..count).map(|index| first + step * index as f64).collect()))
}

/// Parses a name in a list, which may have spaces after its commas.
pub(crate) fn trimmed(text: &str) -> Result<String, Infallible> {
    Ok(text.trim().to_owned())
}

/// A parser of paths of files that an option writes in one format, whatever their names say.
pub(crate) fn file_with_extension(extension: &'static str) -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(move |path| {
        let is_right = path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension));
        let wrong = || format!("expected a name that ends in .{extension}, the format that this option writes");
        if is_right { Ok(path) } else { Err(wrong()) }
    })
}

/// Parses `ROW_A=ROW_B`. Row names may contain `=` (e.g. `l4dgs ablation=full`); the middle one of an odd number of
/// signs separates the names.
pub(crate) fn row_pair(text: &str) -> Result<(String, String), String> {
    let signs: Vec<usize> = text.match_indices('=').map(|(at, _)| at).collect();
    let middle = (signs.len() % 2 == 1).then(|| signs[signs.len() / 2]);
    let (a, b) = middle.map(|at| (&text[..at], &text[at + 1..])).unwrap_or_default();
    if a.is_empty() || b.is_empty() {
        return Err(format!("expected ROW_A=ROW_B (e.g. static3dgs=mcgs), not {text}"));
    }
    Ok((a.into(), b.into()))
}

/// Parses a positive number.
pub(crate) fn at_least_one(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|&count| count > 0).ok_or_else(|| "expected a positive whole number".to_owned())
}

/// Parses `K/N` with 1 ≤ K ≤ N.
pub(crate) fn part(text: &str) -> Result<(usize, usize), String> {
    let parsed = text.split_once('/').and_then(|(k, n)| Some((k.parse().ok()?, n.parse().ok()?)));
    parsed
        .filter(|(k, n)| (1..=*n).contains(k))
        .ok_or_else(|| format!("expected K/N with 1 ≤ K ≤ N, e.g. 2/4, not {text}"))
}

/// Parses the number of seeds of `--replicates`.
pub(crate) fn replicates(text: &str) -> Result<usize, String> {
    let count = at_least_one(text)?;
    if count <= MAX_REPLICATES { Ok(count) } else { Err(format!("at most {MAX_REPLICATES} seeds, not {count}")) }
}

/// Parses the half-width of `--precision`.
pub(crate) fn half_width_db(text: &str) -> Result<f64, String> {
    let db = text.trim_end_matches("dB").trim().parse::<f64>().ok().filter(|db| db.is_finite() && *db > 0.0);
    db.ok_or_else(|| format!("expected a positive number of dB, e.g. 0.3, not {text}"))
}

/// Parses a duration longer than zero.
pub(crate) fn some_time(text: &str) -> Result<Duration, String> {
    let time = humantime::parse_duration(text).map_err(|error| error.to_string())?;
    if time.is_zero() { Err("expected a time longer than zero, e.g. 60s".into()) } else { Ok(time) }
}

/// Parses a time of day, e.g. `07:00`.
pub(crate) fn time_of_day(text: &str) -> Result<Time, String> {
    Time::strptime("%H:%M", text).map_err(|_| format!("expected a time of day, e.g. 07:00, not {text}"))
}

/// The duration from `now` to the next time at which the clock shows `time`.
pub(crate) fn left_until(time: Time, now: &Zoned) -> Result<Duration, String> {
    let on_the_day_of = |day: &Zoned| day.with().time(time).build();
    let next =
        on_the_day_of(now).and_then(|today| if today > *now { Ok(today) } else { on_the_day_of(&now.tomorrow()?) });
    let next = next.map_err(|error| format!("no local time {time} today or tomorrow: {error}"))?;
    Ok(now.duration_until(&next).unsigned_abs())
}

/// Checks the log filter here, because otherwise every job would fail on it.
pub(crate) fn log_filter(text: &str) -> Result<String, String> {
    engine::job::check_log_filter(text).map(|()| text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_include_both_ends() {
        assert_eq!(parse_times("0:1:3").unwrap().0, [0.0, 0.5, 1.0]);
        assert_eq!(parse_times("2:2:1").unwrap().0, [2.0]);
        for wrong in ["", "0:1", "0:1:0", "2:9:1", "0:1:-2", "0:nan:3", "0:1:2:3", "a:1:2", "0:1:99999999999999"] {
            assert!(parse_times(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_next_time_of_day_is_today_or_tomorrow() {
        let now: Zoned = "2026-11-23T22:30:00+00:00[+00:00]".parse().unwrap();
        let left = |text: &str| left_until(time_of_day(text).unwrap(), &now).unwrap().as_secs();
        assert_eq!([left("07:00"), left("23:00"), left("22:30")], [8 * 3600 + 1800, 1800, 24 * 3600]);
        assert!(time_of_day("7 o'clock").unwrap_err().contains("07:00"));
    }

    #[test]
    fn row_names_may_contain_equals_signs() {
        let pair = |text: &str| row_pair(text).ok();
        assert_eq!(pair("a=b"), Some(("a".into(), "b".into())));
        assert_eq!(pair("m x=1=m x=2"), Some(("m x=1".into(), "m x=2".into())));
        for wrong in ["", "a", "=", "a=", "=b", "a=b=c"] {
            assert_eq!(pair(wrong), None, "{wrong}");
        }
    }
}

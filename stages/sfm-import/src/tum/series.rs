//! Values with times, as the text files of a sequence list them.

use std::path::Path;

use crate::error::{Result, bad};
use crate::files::read_text;
use crate::number_lines::{Line, lines};

/// Largest difference of two times of one instant, in seconds: the default of the benchmark's own `associate.py`.
pub(super) const TOLERANCE_SECS: f64 = 0.02;

/// A value and its time in seconds.
pub(super) struct Timed<T> {
    pub(super) time_secs: f64,
    pub(super) value: T,
}

/// At least one value, in the order of their times.
pub(super) struct Series<T> {
    items: Vec<Timed<T>>,
}

impl<T> Series<T> {
    /// Reads a file with a value per line. An error names the file.
    pub(super) fn read(path: &Path, value: impl Fn(&Line<'_>) -> Result<Timed<T>>) -> Result<Self> {
        let text = read_text(path)?;
        let items = lines(&text).map(|line| value(&line)).collect::<Result<Vec<_>>>();
        let mut items = items.map_err(|failure| failure.at(path))?;
        if items.is_empty() {
            return Err(bad("the file has no entries").hint("download the sequence again").at(path));
        }
        items.sort_by(|a, b| a.time_secs.total_cmp(&b.time_secs));
        Ok(Self { items })
    }

    /// All values.
    pub(super) fn items(&self) -> &[Timed<T>] {
        &self.items
    }

    /// The last value before a time, and the first one at or after it.
    pub(super) fn around(&self, time_secs: f64) -> [Option<&Timed<T>>; 2] {
        let after = self.items.partition_point(|item| item.time_secs < time_secs);
        [after.checked_sub(1).and_then(|before| self.items.get(before)), self.items.get(after)]
    }

    /// The value of this instant: the nearest one, if it is near enough.
    pub(super) fn nearest(&self, time_secs: f64) -> Option<&T> {
        let distance = |item: &&Timed<T>| (item.time_secs - time_secs).abs();
        let nearest = self.around(time_secs).into_iter().flatten().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        nearest.filter(|item| distance(item) <= TOLERANCE_SECS).map(|item| &item.value)
    }

    /// The first and the last time, for errors.
    pub(super) fn span(&self) -> String {
        let time = |item: Option<&Timed<T>>| item.map_or(f64::NAN, |item| item.time_secs);
        format!("{:.3} s to {:.3} s", time(self.items.first()), time(self.items.last()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_value_is_that_of_the_instant() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "# time value\n2 20\n1 10\n1.03 13\n").unwrap();
        let value = |line: &Line<'_>| line.finite("time value").map(|[time_secs, value]| Timed { time_secs, value });
        let series = Series::read(file.path(), value).unwrap();
        assert_eq!(series.items().iter().map(|item| item.value).collect::<Vec<_>>(), [10.0, 13.0, 20.0]);
        let found = [0.97, 0.99, 1.0, 1.014, 1.016, 1.06, 2.01, 2.5].map(|time| series.nearest(time).copied());
        let expected = [None, Some(10.0), Some(10.0), Some(10.0), Some(13.0), None, Some(20.0), None];
        assert_eq!(found, expected);
        assert_eq!(series.span(), "1.000 s to 2.000 s");
    }
}

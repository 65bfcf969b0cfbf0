//! Text files with a few numbers per line.

use crate::error::{Result, bad};

/// A line of a text file, split at white space.
pub(crate) struct Line<'a> {
    /// Its number in the file, from 1 on.
    pub(crate) number: usize,
    /// At least one word.
    pub(crate) words: Vec<&'a str>,
}

/// The lines that are neither empty nor comments, which begin with `#`.
pub(crate) fn lines(text: &str) -> impl Iterator<Item = Line<'_>> {
    let lines = (1..).zip(text.lines()).map(|(number, line)| Line { number, words: line.split_whitespace().collect() });
    lines.filter(|line| line.words.first().is_some_and(|word| !word.starts_with('#')))
}

impl Line<'_> {
    /// Exactly N numbers, which may be infinite or NaN; `None` for any other line.
    pub(crate) fn numbers<const N: usize>(&self) -> Option<[f64; N]> {
        let numbers: Option<Vec<f64>> = self.words.iter().map(|word| word.parse().ok()).collect();
        numbers?.try_into().ok()
    }

    /// Exactly N finite numbers. The error for any other line has their `meaning`, which may be empty.
    pub(crate) fn finite<const N: usize>(&self, meaning: &str) -> Result<[f64; N]> {
        let numbers = self.numbers().filter(|numbers: &[f64; N]| numbers.iter().all(|number| number.is_finite()));
        let meaning = if meaning.is_empty() { String::new() } else { format!(" ({meaning})") };
        numbers.ok_or_else(|| bad(format!("line {}: {N} finite numbers are expected{meaning}", self.number)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_empty_lines_keep_the_numbers_of_lines() {
        let text = "# time x\n\n1 2\r\n  # 3 4\n 5 -inf \n6\n7 8 9\n";
        let found: Vec<(usize, Option<[f64; 2]>)> = lines(text).map(|line| (line.number, line.numbers())).collect();
        let expected = [(3, Some([1.0, 2.0])), (5, Some([5.0, f64::NEG_INFINITY])), (6, None), (7, None)];
        assert_eq!(found, expected);
        let errors: Vec<String> =
            lines(text).filter_map(|line| line.finite::<2>("time x").err()).map(|it| it.message).collect();
        assert_eq!(errors[0], "line 5: 2 finite numbers are expected (time x)");
        assert_eq!(errors.len(), 3);
    }
}

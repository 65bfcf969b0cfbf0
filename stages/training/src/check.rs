//! Checks of the values of tables.

use std::fmt::Display;

use engine::ParamProblem;

/// Maximum Gaussians: with their moments, 50 million take 35 GB.
pub(crate) const MAX_GAUSSIANS: usize = 50_000_000;

/// Maximum learning rate. Adam moves a value by about its rate per step; with larger steps it cannot converge.
const MAX_RATE: f64 = 10.0;
/// Maximum of weights and sizes; single precision overflows with far larger ones.
const MAX_VALUE: f64 = 1e6;
/// Minimum of positive values; with far smaller ones, squares vanish in single precision.
const MIN_POSITIVE: f64 = 1e-12;

/// Fields with their keys: `fields!(self, count, rate.start)` is `[("count", self.count), ("rate.start", self.rate.start)]`.
macro_rules! fields {
    ($table:expr, $($first:ident $(.$rest:ident)*),+) => {
        [$((concat!(stringify!($first) $(, ".", stringify!($rest))*), $table.$first $(.$rest)*)),+]
    };
}
pub(crate) use fields;

/// A table of a recipe that checks its own values, with those of the tables inside it.
pub(crate) trait Table {
    /// The problems that types cannot express.
    fn check(&self) -> Checks;
}

/// The problems found in a table.
#[derive(Default)]
pub(crate) struct Checks {
    /// The problems so far, in the order of the checks; their keys are relative to the table.
    pub problems: Vec<ParamProblem>,
}

impl Checks {
    /// Adds a problem with `key` unless the condition holds.
    pub(crate) fn require(mut self, key: &str, holds: bool, message: impl Into<String>) -> Self {
        if !holds {
            self.problems.push(ParamProblem { key: key.into(), message: message.into(), hint: None });
        }
        self
    }

    /// Adds the problems of the table `key`.
    pub(crate) fn table(self, key: &str, table: &impl Table) -> Self {
        self.within(key, table.check())
    }

    /// Adds the problems found in the table `key`.
    pub(crate) fn within(mut self, key: &str, mut found: Self) -> Self {
        found.problems.iter_mut().for_each(|problem| problem.key = format!("{key}.{}", problem.key));
        self.problems.extend(found.problems);
        self
    }

    /// The keys with problems, in the order of the checks.
    #[cfg(test)]
    pub(crate) fn keys(&self) -> Vec<&str> {
        self.problems.iter().map(|problem| problem.key.as_str()).collect()
    }

    /// Requires that every value meets a condition.
    pub(crate) fn each<V, const N: usize>(
        self,
        values: [(&str, V); N],
        holds: impl Fn(V) -> bool,
        message: &str,
    ) -> Self {
        values.into_iter().fold(self, |checks, (key, value)| checks.require(key, holds(value), message))
    }

    /// Requires at least 1.
    pub(crate) fn at_least_one<V: PartialOrd + From<u8>, const N: usize>(self, values: [(&str, V); N]) -> Self {
        self.each(values, |value| value >= V::from(1), "must be at least 1")
    }

    /// Requires at most `max`.
    pub(crate) fn at_most<V: PartialOrd + Display, const N: usize>(self, max: V, values: [(&str, V); N]) -> Self {
        self.each(values, |value| value <= max, &format!("must be at most {max}"))
    }

    /// Requires 1 to `max`.
    pub(crate) fn counts<const N: usize>(self, max: usize, values: [(&str, usize); N]) -> Self {
        self.each(values, |value| (1..=max).contains(&value), &format!("must be 1 to {max}"))
    }

    /// Requires a list of at least one number, each 1 to `max`.
    pub(crate) fn list_of_counts(self, max: usize, key: &str, values: &[usize]) -> Self {
        let holds = !values.is_empty() && values.iter().all(|value| (1..=max).contains(value));
        self.require(key, holds, format!("must be one or more numbers from 1 to {max}"))
    }

    /// Requires 0 to [`MAX_VALUE`].
    pub(crate) fn not_negative<const N: usize>(self, values: [(&str, f64); N]) -> Self {
        self.each(values, |value| (0.0..=MAX_VALUE).contains(&value), &format!("must be 0 to {MAX_VALUE:e}"))
    }

    /// Requires [`MIN_POSITIVE`] to [`MAX_VALUE`].
    pub(crate) fn positive<const N: usize>(self, values: [(&str, f64); N]) -> Self {
        let message = format!("must be {MIN_POSITIVE:e} to {MAX_VALUE:e}");
        self.each(values, |value| (MIN_POSITIVE..=MAX_VALUE).contains(&value), &message)
    }

    /// Requires learning rates: positive values of at most [`MAX_RATE`].
    pub(crate) fn rates<const N: usize>(self, values: [(&str, f64); N]) -> Self {
        self.each(values, |value| value > 0.0 && value <= MAX_RATE, &format!("must be in (0, {MAX_RATE}]"))
    }

    /// Requires values in [0, 1].
    pub(crate) fn shares<const N: usize>(self, values: [(&str, f64); N]) -> Self {
        self.each(values, |value| (0.0..=1.0).contains(&value), "must be in [0, 1]")
    }

    /// Requires values in (0, 1).
    pub(crate) fn open_shares<const N: usize>(self, values: [(&str, f64); N]) -> Self {
        self.each(values, |value| value > 0.0 && value < 1.0, "must be in (0, 1)")
    }
}

/// Whether a value is positive and finite.
pub(crate) fn is_positive(value: f64) -> bool {
    value > 0.0 && value.is_finite()
}

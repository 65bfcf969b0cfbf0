//! Checks of the values of a table.

use engine::ParamProblem;

/// Maximum Gaussians: with their moments, 50 million take 35 GB.
pub(super) const MAX_GAUSSIANS: usize = 50_000_000;

/// The problems found in a table.
pub(super) struct Checks {
    /// The table's name with a trailing dot; empty for the top level.
    prefix: String,
    /// The problems so far, in the order of the checks.
    pub problems: Vec<ParamProblem>,
}

impl Checks {
    /// No problems yet in a table; the empty name is the top level.
    pub(crate) fn of(table: &str) -> Self {
        let prefix = if table.is_empty() { String::new() } else { format!("{table}.") };
        Self { prefix, problems: Vec::new() }
    }

    /// Adds a problem with `key` unless the condition holds.
    pub(crate) fn require(mut self, key: &str, holds: bool, message: impl Into<String>) -> Self {
        if !holds {
            let key = format!("{}{key}", self.prefix);
            self.problems.push(ParamProblem { key, message: message.into(), hint: None });
        }
        self
    }

    /// Requires at least 1.
    pub(crate) fn at_least_one(self, key: &str, value: u64) -> Self {
        self.require(key, value > 0, "must be at least 1")
    }

    /// Requires a positive, finite value.
    pub(crate) fn positive(self, key: &str, value: f64) -> Self {
        self.require(key, is_positive(value), "must be positive")
    }

    /// Requires a value in (0, 1).
    pub(crate) fn open_share(self, key: &str, value: f64) -> Self {
        self.require(key, value > 0.0 && value < 1.0, "must be in (0, 1)")
    }

    /// Requires 1 to [`MAX_GAUSSIANS`].
    pub(crate) fn gaussians(self, key: &str, count: usize) -> Self {
        self.require(key, is_count(count, MAX_GAUSSIANS), format!("must be 1 to {MAX_GAUSSIANS}"))
    }
}

/// Whether a count is 1 to `max`.
pub(super) fn is_count(count: usize, max: usize) -> bool {
    (1..=max).contains(&count)
}

/// Whether a value is positive and finite.
pub(super) fn is_positive(value: f64) -> bool {
    value > 0.0 && value.is_finite()
}

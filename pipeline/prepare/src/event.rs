//! Progress reports of a preparation.

/// A report of one step.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The result of an earlier run is kept.
    Kept {
        /// Name of the step.
        step: String,
        /// Its result, in words.
        summary: String,
    },
    /// A step begins.
    Started {
        /// Name of the step.
        step: String,
        /// The command, shortened to its program.
        command: String,
    },
    /// A step has done `done` of about `total` units.
    Progress {
        /// Units that are done.
        done: u64,
        /// All units.
        total: u64,
    },
    /// A step has ended.
    Finished {
        /// Name of the step.
        step: String,
        /// Its result, in words.
        summary: String,
        /// Seconds that it took.
        secs: f64,
    },
    /// Something that the user should know.
    Note(String),
}

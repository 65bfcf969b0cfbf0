//! Errors that end the program, with their exit codes and messages.

use std::fmt;
use std::io::{self, ErrorKind};

use engine::plan::NothingSelected;
use engine::recipe::RecipeErrors;
use engine::{Failure, FailureKind, exit};

/// The exit code of a wrong command line, which is also that of the command-line parser.
const USAGE: u8 = 2;
/// Jobs that the error of `--frozen` names; the others are counted.
const MAX_FROZEN: usize = 5;

/// An error that ends the program.
#[derive(Debug)]
pub(crate) enum CliError {
    /// All errors of an invalid recipe.
    Recipe(RecipeErrors),
    /// Options of the command line that do not belong together.
    Usage(String),
    /// A name matches nothing, or the named job has no result.
    Nothing { message: String, hint: String },
    /// The jobs that would have to run under `--frozen`.
    Frozen(Vec<String>),
    /// A result in the store that the verb reads is damaged: which one, and the problem.
    Damaged(String),
    /// A file or folder that the user named is invalid.
    Input(anyhow::Error),
    /// Standard output cannot be written.
    Output(io::Error),
    /// The machine or the store failed.
    Other(anyhow::Error),
}

impl CliError {
    /// A [`Self::Nothing`] of this message and hint.
    pub(crate) fn nothing(message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Nothing { message: message.into(), hint: hint.into() }
    }

    /// Classifies an error that occurred while reading a path that the user named: bad input unless the machine failed.
    pub(crate) fn of_input(error: anyhow::Error) -> Self {
        if is_of_machine(&error) { Self::Other(error) } else { Self::Input(error) }
    }

    /// Whether the reader of standard output exited early (e.g. `head`), which needs no message.
    pub(crate) fn reader_is_gone(&self) -> bool {
        matches!(self, Self::Output(error) if error.kind() == ErrorKind::BrokenPipe)
    }

    /// The program's exit code.
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) => USAGE,
            Self::Recipe(_) | Self::Input(_) => exit::INPUT,
            Self::Nothing { .. } => exit::NOTHING,
            Self::Frozen(_) => exit::FROZEN,
            Self::Damaged(_) => exit::DAMAGED,
            Self::Output(_) if self.reader_is_gone() => exit::READER_GONE,
            Self::Output(_) | Self::Other(_) => exit::INFRASTRUCTURE,
        }
    }
}

impl fmt::Display for CliError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Recipe(errors) => write!(f, "{errors}"),
            Self::Usage(message) => write!(f, "error: {message}"),
            Self::Nothing { message, hint } => write!(f, "error: {message}\nhint: {hint}"),
            Self::Frozen(jobs) => {
                let some: Vec<&str> = jobs.iter().take(MAX_FROZEN).map(String::as_str).collect();
                let more = if jobs.len() > some.len() { ", …" } else { "" };
                write!(f, "error: {} jobs would have to run: {}{more}", jobs.len(), some.join(", "))?;
                write!(f, "\nhint: run without --frozen; `pipeline plan` shows the reasons")
            }
            Self::Damaged(problem) => {
                write!(f, "error: {problem}\nhint: run the recipe again, which replaces damaged results; ")?;
                write!(f, "`pipeline cache verify` lists all damaged files")
            }
            Self::Output(error) => write!(f, "error: cannot write to standard output ({error})"),
            Self::Input(error) | Self::Other(error) => write_failure(f, error),
        }
    }
}

/// Whether the error is a failure of the machine and not of the input.
fn is_of_machine(error: &anyhow::Error) -> bool {
    let failure = error.chain().find_map(|cause| cause.downcast_ref::<Failure>());
    let of_failure = failure.map(|failure| !matches!(failure.kind, FailureKind::BadInput | FailureKind::MissingData));
    let io_error = error.chain().find_map(|cause| cause.downcast_ref::<io::Error>());
    of_failure.or(io_error.map(|error| error.kind() != ErrorKind::NotFound)).unwrap_or(false)
}

/// Writes the message and the path on one line, and the hint, if there is one, on the next.
fn write_failure(f: &mut fmt::Formatter<'_>, error: &anyhow::Error) -> fmt::Result {
    let Some(failure) = error.chain().find_map(|cause| cause.downcast_ref::<Failure>()) else {
        return write!(f, "error: {error:#}");
    };
    write!(f, "error: {}", failure.message)?;
    failure.path.iter().try_for_each(|path| write!(f, ": {}", path.display()))?;
    failure.hint.iter().try_for_each(|hint| write!(f, "\nhint: {hint}"))
}

impl From<RecipeErrors> for CliError {
    fn from(errors: RecipeErrors) -> Self {
        Self::Recipe(errors)
    }
}

impl From<NothingSelected> for CliError {
    fn from(nothing: NothingSelected) -> Self {
        Self::nothing(nothing.to_string(), "`pipeline plan RECIPE` lists all jobs")
    }
}

impl From<anyhow::Error> for CliError {
    fn from(error: anyhow::Error) -> Self {
        let bad_input = |failure: &Failure| failure.kind == FailureKind::BadInput;
        if error.downcast_ref::<Failure>().is_some_and(bad_input) { Self::Input(error) } else { Self::Other(error) }
    }
}

impl From<io::Error> for CliError {
    fn from(error: io::Error) -> Self {
        Self::Other(error.into())
    }
}

impl From<serde_json::Error> for CliError {
    fn from(error: serde_json::Error) -> Self {
        Self::Other(error.into())
    }
}

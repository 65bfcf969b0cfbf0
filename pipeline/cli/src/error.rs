//! What goes wrong on the command line, each with its exit code; printed once.

use std::fmt;
use std::io::{self, ErrorKind};

use engine::plan::NothingSelected;
use engine::recipe::RecipeErrors;
use engine::{Failure, FailureKind, exit};

use crate::comparison::ProtocolsDiffer;

/// An error that ends the program.
#[derive(Debug)]
pub enum CliError {
    /// The recipe is invalid; all its errors.
    Recipe(RecipeErrors),
    /// Nothing is called like that, or it has no result.
    Nothing { message: String, hint: Option<String> },
    /// Numbers of different protocols were to be compared.
    Incomparable(Box<ProtocolsDiffer>),
    /// With `--frozen`: these jobs would have to run.
    Frozen(Vec<String>),
    /// What the user gave to read is wrong.
    Input(anyhow::Error),
    /// Standard output could not be written.
    Output(io::Error),
    /// The machine or the store failed.
    Other(anyhow::Error),
}

impl CliError {
    pub fn nothing(message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Nothing { message: message.into(), hint: Some(hint.into()) }
    }

    /// An error of something that reads what the user names: the input's fault unless the machine failed.
    pub fn of_input(error: anyhow::Error) -> Self {
        if is_of_machine(&error) { Self::Other(error) } else { Self::Input(error) }
    }

    /// Whether whoever read the output went away, as `head` does; nobody wants to be told.
    pub fn reader_is_gone(&self) -> bool {
        matches!(self, Self::Output(error) if error.kind() == ErrorKind::BrokenPipe)
    }

    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Recipe(_) | Self::Input(_) | Self::Incomparable(_) => exit::INPUT,
            Self::Nothing { .. } => exit::NOTHING,
            Self::Frozen(_) => exit::FROZEN,
            Self::Output(_) if self.reader_is_gone() => exit::READER_GONE,
            Self::Output(_) | Self::Other(_) => exit::INFRASTRUCTURE,
        }
    }
}

impl fmt::Display for CliError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Recipe(errors) => write!(f, "{errors}"),
            Self::Nothing { message, hint } => {
                write!(f, "error: {message}")?;
                hint.iter().try_for_each(|hint| write!(f, "\nhint: {hint}"))
            }
            Self::Incomparable(differ) => write!(f, "error: {differ}"),
            Self::Frozen(jobs) => {
                let some: Vec<&str> = jobs.iter().take(5).map(String::as_str).collect();
                let more = if jobs.len() > some.len() { ", …" } else { "" };
                write!(f, "error: {} jobs would have to run: {}{more}", jobs.len(), some.join(", "))?;
                write!(f, "\nhint: run without --frozen, or see `pipeline plan` for the reasons")
            }
            Self::Output(error) => write!(f, "error: cannot write to standard output ({error})"),
            Self::Input(error) | Self::Other(error) => write_failure(f, error),
        }
    }
}

/// Whether the machine failed, as opposed to what the user gave us.
fn is_of_machine(error: &anyhow::Error) -> bool {
    let failure = error.chain().find_map(|cause| cause.downcast_ref::<Failure>());
    let of_failure = failure.map(|failure| !matches!(failure.kind, FailureKind::BadInput | FailureKind::MissingData));
    let io_error = error.chain().find_map(|cause| cause.downcast_ref::<io::Error>());
    of_failure.or(io_error.map(|error| error.kind() != ErrorKind::NotFound)).unwrap_or(false)
}

/// The message in one line, path last, then the hint if the error has one.
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
        let hint = Some("`pipeline plan RECIPE` lists all jobs".into());
        Self::Nothing { message: nothing.to_string(), hint }
    }
}

impl From<anyhow::Error> for CliError {
    fn from(error: anyhow::Error) -> Self {
        let bad_input = |failure: &Failure| failure.kind == FailureKind::BadInput;
        if error.downcast_ref::<Failure>().is_some_and(bad_input) { Self::Input(error) } else { Self::Other(error) }
    }
}

impl From<std::io::Error> for CliError {
    fn from(error: std::io::Error) -> Self {
        Self::Other(error.into())
    }
}

impl From<serde_json::Error> for CliError {
    fn from(error: serde_json::Error) -> Self {
        Self::Other(error.into())
    }
}

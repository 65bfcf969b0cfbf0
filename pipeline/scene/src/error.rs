use std::path::PathBuf;

/// A problem with scene data: what is wrong, what to do about it, and the file concerned (printed last).
#[derive(Debug, thiserror::Error)]
#[error("{message}{}{}", .hint.as_ref().map(|hint| format!("; {hint}")).unwrap_or_default(), .path.as_ref().map(|path| format!(": {}", path.display())).unwrap_or_default())]
pub struct Error {
    /// What is wrong, lower case, without a full stop.
    pub message: String,
    /// What to do about it.
    pub hint: Option<String>,
    /// The file or folder concerned.
    pub path: Option<PathBuf>,
}

/// Results of the vocabulary.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// A problem described by `message`.
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), hint: None, path: None }
    }

    /// The same problem with advice.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// The same problem about a file or folder.
    pub fn at(mut self, path: impl Into<PathBuf>) -> Self {
        self.path = Some(path.into());
        self
    }
}

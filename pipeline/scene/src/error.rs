//! The error type of this crate.

use std::io;
use std::path::PathBuf;

/// An error in scene data: what is wrong, a hint, and the file concerned (printed last).
#[derive(Debug, thiserror::Error)]
#[error("{message}{}{}", .hint.as_ref().map(|hint| format!("; {hint}")).unwrap_or_default(), .path.as_ref().map(|path| format!(": {}", path.display())).unwrap_or_default())]
pub struct Error {
    /// What is wrong, in lower case, without a full stop.
    pub message: String,
    /// What the user can do about it.
    pub hint: Option<String>,
    /// The file or folder concerned.
    pub path: Option<PathBuf>,
    /// The I/O error, if the machine is the cause and not the data, e.g. a full disk.
    pub source: Option<io::Error>,
}

/// The result type of this crate.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An error with a message (lower case, without a full stop).
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), hint: None, path: None, source: None }
    }

    /// Sets the I/O error that caused this one.
    pub(crate) fn because_of(mut self, source: io::Error) -> Self {
        self.source = Some(source);
        self
    }

    /// Sets the hint.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Sets the file or folder concerned.
    pub fn at(mut self, path: impl Into<PathBuf>) -> Self {
        self.path = Some(path.into());
        self
    }
}

#[cfg(test)]
mod tests {
    use std::error::Error as _;
    use std::path::Path;

    /// Every write to `/dev/full` fails like a write to a full disk.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_reported_as_an_io_error() {
        let error = crate::image_file::write_file(Path::new("/dev/full"), b"x").unwrap_err();
        let source = error.source().and_then(|source| source.downcast_ref::<std::io::Error>());
        assert_eq!(source.map(std::io::Error::kind), Some(std::io::ErrorKind::StorageFull), "{error}");
    }
}

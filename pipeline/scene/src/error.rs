use std::io;
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
    /// What the machine refused, where that is the reason: then nobody's data is wrong.
    pub source: Option<io::Error>,
}

/// Results of the vocabulary.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// A problem described by `message`.
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), hint: None, path: None, source: None }
    }

    /// The same problem, which the machine is the reason for.
    pub(crate) fn because_of(mut self, source: io::Error) -> Self {
        self.source = Some(source);
        self
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

#[cfg(test)]
mod tests {
    use std::error::Error as _;
    use std::path::Path;

    /// Every write to this device fails as on a full disk.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_the_machines_fault() {
        let error = crate::image_file::write_file(Path::new("/dev/full"), b"x").unwrap_err();
        let source = error.source().and_then(|source| source.downcast_ref::<std::io::Error>());
        assert_eq!(source.map(std::io::Error::kind), Some(std::io::ErrorKind::StorageFull), "{error}");
    }
}

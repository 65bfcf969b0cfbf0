//! Blobs: files named by the SHA-256 of their bytes.

use std::fs::{Metadata, Permissions};
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use fs_err as fs;
use tempfile::{PathPersistError, TempPath};

use super::{Store, at_path, sync_dir};
use crate::Digest;

impl Store {
    /// The path of the blob with this digest: `cas/ab/cdef…`.
    pub fn blob_path(&self, digest: &Digest) -> PathBuf {
        self.root.join(blob_name(digest))
    }

    /// Reads a blob and checks its bytes against the digest.
    pub fn read_blob(&self, digest: &Digest) -> io::Result<Vec<u8>> {
        let bytes = fs::read(self.blob_path(digest))?;
        if Digest::of(&bytes) != *digest {
            return Err(io::Error::new(ErrorKind::InvalidData, format!("blob {} is damaged", digest.short())));
        }
        Ok(bytes)
    }

    /// Stores bytes as a blob. Its content is durable; its name becomes so with that of its folder.
    pub(super) fn put_bytes(&self, bytes: &[u8]) -> io::Result<Digest> {
        let digest = Digest::of(bytes);
        let file = self.scratch_file()?;
        let mut open = file.as_file();
        let written = open.write_all(bytes);
        let protected = written.and_then(|()| open.set_permissions(Permissions::from_mode(0o444)));
        protected.and_then(|()| open.sync_all()).map_err(at_path(file.path()))?;
        self.place(file.into_temp_path(), &digest, bytes.len() as u64)?;
        Ok(digest)
    }

    /// Moves a finished file (synced, read-only, on this file system) to the path of the blob `digest`.
    ///
    /// If the blob exists and is intact, it stays and the file is removed. A damaged blob is moved to quarantine. The
    /// caller makes the name durable by syncing the blob's folder; a new folder is durable.
    pub(super) fn place(&self, file: TempPath, digest: &Digest, size_bytes: u64) -> io::Result<()> {
        let path = self.blob_path(digest);
        if path.exists() && !is_intact(&path, digest, size_bytes) {
            self.quarantine(&path)?;
        }
        // The folder, one of 256, exists in nearly all cases.
        let placed = file.persist_noclobber(&path).or_else(|failed| match failed.error.kind() {
            ErrorKind::NotFound => match self.add_shard(&path) {
                Ok(()) => failed.path.persist_noclobber(&path),
                Err(error) => Err(PathPersistError { error, path: failed.path }),
            },
            _ => Err(failed),
        });
        match placed {
            Err(error) if error.error.kind() != ErrorKind::AlreadyExists => Err(at_path(&path)(error.error)),
            _ => Ok(()),
        }
    }

    /// Creates the folder of a blob durably.
    fn add_shard(&self, blob: &Path) -> io::Result<()> {
        fs::create_dir_all(blob.parent().unwrap_or(&self.root))?;
        sync_dir(&self.root.join("cas"))
    }

    /// Moves a damaged file or folder to quarantine, where it is kept for inspection.
    pub(super) fn quarantine(&self, path: &Path) -> io::Result<()> {
        let folder = self.root.join("quarantine");
        fs::create_dir_all(&folder)?;
        let name = path.strip_prefix(&self.root).unwrap_or(path).to_string_lossy().replace('/', "-");
        // Damaged files of the same name are numbered.
        let free = (0..).map(|number| folder.join(format!("{name}.{number}"))).find(|target| !target.exists());
        match fs::rename(path, free.unwrap_or_else(|| folder.join(name))) {
            // Another process has moved it already.
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
            other => other,
        }
    }
}

/// A blob's path relative to the store.
pub(super) fn blob_name(digest: &Digest) -> PathBuf {
    let hex = digest.to_string();
    Path::new("cas").join(&hex[..2]).join(&hex[2..])
}

/// Whether the file has this size and this digest.
pub(super) fn is_intact(path: &Path, digest: &Digest, size_bytes: u64) -> bool {
    let right_size = fs::symlink_metadata(path).is_ok_and(|meta| meta.is_file() && meta.len() == size_bytes);
    right_size && Digest::of_file(path).is_ok_and(|found| found == *digest)
}

/// The time of the last change of a file's contents or inode, in nanoseconds since 1970.
pub(super) fn changed_ns(meta: &Metadata) -> i128 {
    let nanos = |secs: i64, nanos: i64| i128::from(secs) * 1_000_000_000 + i128::from(nanos);
    nanos(meta.mtime(), meta.mtime_nsec()).max(nanos(meta.ctime(), meta.ctime_nsec()))
}

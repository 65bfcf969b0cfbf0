//! The store: blobs named by their SHA-256, folders as manifests, and one record per action key.
//!
//! ```text
//! FORMAT                      version of this layout
//! cas/ab/cdef…                blobs, read-only
//! verified/<manifest>         marker: the manifest's blobs matched their names at this file's time
//! views/<manifest>/…          a folder of links into cas, for reading in place
//! results/<recipe>/<node>     link to the view of the node's last result, for people
//! records/<action key>.json   what a job made and from what: the commit point of a publication
//! failures/<action key>.json  the last failure of an action; never a cache hit
//! checkpoints/<action key>/   what an interrupted job saved
//! runs/<run>/                 plan, events and one folder per job with its logs
//! locks/, tmp/, quarantine/   economy, scratch, and what was found damaged
//! ```
//! Locks only save work; correctness rests on content addressing and on renames that never replace.

mod blob;
mod lookup;
mod maintenance;
mod manifest;
mod publish;
mod record;
mod results;
mod view;

use std::fs;
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use anyhow::Context;

use crate::{Failure, FailureKind};

pub use lookup::Lookup;
pub use maintenance::{Damage, GcReport, Usage};
pub use manifest::{Manifest, ManifestFile};
pub use publish::Publication;
pub use record::{ActionRecord, FailureRecord, Provenance};

/// The version of the layout. A store of a newer version is refused, since this binary cannot know its rules.
const FORMAT: u32 = 1;

/// What the temporary file is called that becomes FORMAT.
const NEW_FORMAT_PREFIX: &str = ".FORMAT-";

/// The folders of a store; those that are not there from the start are made when needed.
const FOLDERS: [&str; 9] = ["cas", "verified", "views", "records", "failures", "checkpoints", "runs", "locks", "tmp"];

/// A store on a local disk; cheap to clone, holds no lock and no open file.
#[derive(Clone, Debug)]
pub struct Store {
    root: PathBuf,
}

impl Store {
    /// Opens the store in `root`, making it if there is nothing or an empty folder. A folder with anything else in it
    /// is refused: collections would take foreign files for garbage.
    pub fn open(root: &Path) -> anyhow::Result<Self> {
        let make = |error| Failure::new(FailureKind::World, format!("cannot make the store ({error})")).at(root);
        fs::create_dir_all(root).map_err(make)?;
        let store = Self { root: fs::canonicalize(root).map_err(make)? };
        if !store.exists() {
            store.refuse_foreign_folder()?;
            store.write_format().map_err(make)?;
        }
        store.check_format()?;
        for folder in FOLDERS {
            fs::create_dir_all(store.root.join(folder)).map_err(make)?;
        }
        Ok(store)
    }

    /// Opens the store in `root` to look at it and makes nothing: where there is no store, it reads as an empty one.
    pub fn look(root: &Path) -> anyhow::Result<Self> {
        let absolute = if root.exists() { fs::canonicalize(root) } else { std::path::absolute(root) };
        let store = Self { root: absolute.map_err(naming(root)).context("cannot open the store")? };
        if store.exists() {
            store.check_format()?;
        } else if store.root.exists() {
            store.refuse_foreign_folder()?;
        }
        Ok(store)
    }

    /// Whether there is a store, or only the place for one.
    pub fn exists(&self) -> bool {
        self.format_file().exists()
    }

    /// The store's folder, absolute.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The folder of one run.
    pub fn run_dir(&self, run: &str) -> PathBuf {
        self.root.join("runs").join(run)
    }

    /// The folder in which an interrupted job of `action_key` left its checkpoint.
    pub fn checkpoint_dir(&self, action_key: &str) -> PathBuf {
        self.root.join("checkpoints").join(action_key)
    }

    /// Whether an interrupted job of `action_key` left anything to continue from.
    pub fn has_checkpoint(&self, action_key: &crate::ActionKey) -> bool {
        let entries = fs::read_dir(self.checkpoint_dir(action_key.as_str()));
        entries.is_ok_and(|mut entries| entries.next().is_some())
    }

    /// The file whose lock a runner of `action_key` holds.
    pub fn lock_file(&self, action_key: &str) -> PathBuf {
        self.root.join("locks").join(action_key)
    }

    /// The cache of source digests.
    pub fn stat_cache_file(&self) -> PathBuf {
        self.root.join("sources.json")
    }

    /// Marks the store as in use until the returned file is dropped: nothing is swept away meanwhile.
    pub fn lock_shared(&self) -> io::Result<fs::File> {
        let path = self.root.join("LOCK");
        let file = crate::lock::open(&path).map_err(naming(&path))?;
        file.lock_shared().map_err(naming(&path))?;
        Ok(file)
    }

    /// The store for this process alone, or nothing if anybody uses it.
    pub fn try_lock_exclusive(&self) -> anyhow::Result<Option<fs::File>> {
        let path = self.root.join("LOCK");
        let file = crate::lock::open(&path).map_err(naming(&path)).context("cannot lock the store")?;
        Ok(crate::lock::try_exclusive(&file).map_err(naming(&path)).context("cannot lock the store")?.then_some(file))
    }

    /// Marks the store as in use, after sweeping away what crashed runs left in `tmp`, if nobody else is there.
    pub fn enter(&self) -> anyhow::Result<fs::File> {
        if let Some(_alone) = self.try_lock_exclusive()? {
            for entry in fs::read_dir(self.root.join("tmp"))? {
                let path = entry?.path();
                let removed = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
                removed.with_context(|| format!("cannot remove {}", path.display()))?;
            }
        }
        self.lock_shared().context("cannot lock the store")
    }

    /// A fresh folder on the store's file system; removed when dropped. The caller holds the lock, shared.
    pub fn scratch(&self, purpose: &str) -> io::Result<tempfile::TempDir> {
        tempfile::Builder::new().prefix(&format!("{purpose}-")).tempdir_in(self.root.join("tmp"))
    }

    /// Writes a file that must not exist yet, durably: temporary file (where the next run sweeps, if this process is
    /// killed), fsync, rename that never replaces.
    fn write_new(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let _in_use = self.lock_shared()?;
        let mut file = new_file("", &self.root.join("tmp"))?;
        file.write_all(bytes).map_err(naming(path))?;
        file.as_file().sync_all().map_err(naming(path))?;
        file.persist_noclobber(path).map_err(|error| naming(path)(error.error))?;
        sync_dir(path.parent().unwrap_or(&self.root))
    }

    /// Writes a file, replacing what is there in one step.
    pub(crate) fn write_over(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let _in_use = self.lock_shared()?;
        let mut file = new_file("", &self.root.join("tmp"))?;
        file.write_all(bytes).map_err(naming(path))?;
        file.persist(path).map_err(|error| naming(path)(error.error))?;
        Ok(())
    }

    fn format_file(&self) -> PathBuf {
        self.root.join("FORMAT")
    }

    /// An error if the folder, which has no FORMAT, holds anything but another process's beginnings of a store.
    fn refuse_foreign_folder(&self) -> anyhow::Result<()> {
        let entries = fs::read_dir(&self.root).map_err(naming(&self.root)).context("cannot open the store")?;
        for entry in entries {
            let begun = entry?.file_name().to_string_lossy().starts_with(NEW_FORMAT_PREFIX);
            // Another process may have made the whole store since it was looked for.
            if !begun && !self.exists() {
                let foreign = Failure::new(FailureKind::BadInput, "this folder is not a store and is not empty");
                return Err(foreign.hint("give another folder with --store").at(&self.root).into());
            }
        }
        Ok(())
    }

    /// Makes FORMAT, the first file of a store. Two processes may do so at once; both write the same line.
    fn write_format(&self) -> io::Result<()> {
        let mut file = new_file(NEW_FORMAT_PREFIX, &self.root)?;
        file.write_all(format!("{FORMAT}\n").as_bytes())?;
        file.as_file().sync_all()?;
        match file.persist_noclobber(self.format_file()) {
            Err(error) if error.error.kind() != ErrorKind::AlreadyExists => Err(error.error),
            _ => sync_dir(&self.root),
        }
    }

    fn check_format(&self) -> anyhow::Result<()> {
        let path = self.format_file();
        match fs::read_to_string(&path) {
            Err(error) => Err(error).with_context(|| format!("cannot read {}", path.display())),
            Ok(text) => match text.trim().parse::<u32>() {
                Ok(FORMAT) => Ok(()),
                Ok(version) => Err(Failure::new(
                    FailureKind::World,
                    format!("the store has format {version}, this program knows format {FORMAT}"),
                )
                .hint("use a newer program, or another folder with --store")
                .at(path)
                .into()),
                Err(_) => Err(Failure::new(FailureKind::World, "this is not a store: FORMAT holds no number")
                    .hint("choose another folder with --store")
                    .at(path)
                    .into()),
            },
        }
    }
}

/// The same error, with the file that it is about at the end of its message.
pub(crate) fn naming(path: &Path) -> impl Fn(io::Error) -> io::Error {
    move |error| io::Error::new(error.kind(), format!("{error}: {}", path.display()))
}

/// A temporary file with the rights that the user's umask gives any new file, so that colleagues may read what it becomes.
fn new_file(prefix: &str, dir: &Path) -> io::Result<tempfile::NamedTempFile> {
    let rights = fs::Permissions::from_mode(0o666); // less the umask
    tempfile::Builder::new().prefix(prefix).permissions(rights).tempfile_in(dir)
}

fn sync_dir(dir: &Path) -> io::Result<()> {
    fs::File::open(dir).and_then(|file| file.sync_all()).map_err(naming(dir))
}

#[cfg(test)]
mod tests;

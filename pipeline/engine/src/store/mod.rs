//! The store: blobs named by their SHA-256, folders as manifests, and one record per action key.
//!
//! ```text
//! FORMAT                      version of this layout
//! cas/ab/cdef…                blobs, read-only
//! verified/<manifest>         marker: the manifest's blobs matched their names at the time of this file
//! views/<manifest>/…          a folder of links into cas, for reading in place
//! results/<recipe>/<node>     link to the view of the node's last result, for users
//! records/<action key>.json   a job's result and inputs: the commit point of a publication
//! failures/<action key>.json  the last failure of an action; never a cache hit
//! checkpoints/<action key>/   checkpoints of an interrupted job
//! runs/<run>/                 plan, events and one folder per job with its logs
//! claims/<action key>         the process that works on the action, as a lease with a heartbeat
//! programs/                   copies of this program for batch jobs
//! sweeps/                     histories and reports of searches
//! tmp/, quarantine/           scratch files, damaged files
//! sources.json                cached digests of source files
//! LOCK                        locked shared by processes that use the store, exclusively by garbage collection
//! ```
//! Claims only save work. Correctness rests on content addressing and on renames that never replace a file, so a store may
//! lie on a network file system and serve processes of many machines.

mod blob;
mod claim;
mod lookup;
mod maintenance;
mod manifest;
mod publish;
mod record;
mod results;
mod view;

use std::fs::File;
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use anyhow::Context;
use fs_err as fs;

use crate::process::ProcessId;
use crate::{Failure, FailureKind};

pub use claim::{Claim, Holder, Watch};
pub use lookup::Lookup;
pub use maintenance::{Damage, GcReport, Keep, Usage};
pub use manifest::{Manifest, ManifestFile};
pub use publish::Publication;
pub use record::{ActionRecord, FailureRecord, Provenance};

/// The version of the layout. A store of another version is refused, because this binary could misread or damage it.
const FORMAT: u32 = 1;

/// The prefix of the temporary file that becomes FORMAT.
const NEW_FORMAT_PREFIX: &str = ".FORMAT-";

/// The folders of a new store. Others are created when needed.
const FOLDERS: [&str; 9] = ["cas", "verified", "views", "records", "failures", "checkpoints", "runs", "claims", "tmp"];

/// Scratch files of other machines are removed at this age: no job takes a month.
const MAX_SCRATCH_AGE: std::time::Duration = std::time::Duration::from_secs(30 * 24 * 3600);

/// A store on a local disk or a network file system. It is cheap to clone, and holds no lock and no open file.
#[derive(Clone, Debug)]
pub struct Store {
    root: PathBuf,
}

impl Store {
    /// Opens the store in `root`. A missing or empty folder becomes a store. A folder with other files is refused,
    /// because garbage collection would remove them.
    pub fn open(root: &Path) -> anyhow::Result<Self> {
        let make = |error| Failure::new(FailureKind::World, format!("cannot create the store ({error})")).at(root);
        fs::create_dir_all(root).map_err(make)?;
        let store = Self { root: fs::canonicalize(root).map_err(make)? };
        if store.root.to_str().is_none() {
            let failure = Failure::new(FailureKind::BadInput, "the path of the store is not UTF-8");
            return Err(failure.hint("choose another folder with --store").at(root).into());
        }
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

    /// Opens the store in `root` for reading and creates nothing. A missing store reads as an empty one.
    pub fn open_read_only(root: &Path) -> anyhow::Result<Self> {
        let absolute = if root.exists() { fs::canonicalize(root) } else { std::path::absolute(root) };
        let store = Self { root: absolute.context("cannot open the store")? };
        if store.exists() {
            store.check_format()?;
        } else if store.root.exists() {
            store.refuse_foreign_folder()?;
        }
        Ok(store)
    }

    /// Whether the store exists.
    pub fn exists(&self) -> bool {
        self.format_file().exists()
    }

    /// Whether this process may add files to the store.
    pub fn is_writable(&self) -> bool {
        self.scratch_file().is_ok()
    }

    /// The absolute path of the store's folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The folder of one run.
    pub fn run_dir(&self, run: &str) -> PathBuf {
        self.root.join("runs").join(run)
    }

    /// The folder for checkpoints of interrupted jobs with this action key.
    pub fn checkpoint_dir(&self, action_key: &str) -> PathBuf {
        self.root.join("checkpoints").join(action_key)
    }

    /// Whether an interrupted job with this action key left a checkpoint.
    pub fn has_checkpoint(&self, action_key: &crate::ActionKey) -> bool {
        let entries = fs::read_dir(self.checkpoint_dir(action_key.as_str()));
        entries.is_ok_and(|mut entries| entries.next().is_some())
    }

    /// The file that caches source digests.
    pub fn stat_cache_file(&self) -> PathBuf {
        self.root.join("sources.json")
    }

    /// Marks the store as in use by this machine until the returned file is dropped. Waits while garbage collection
    /// runs; garbage collection refuses to start meanwhile, and while a process of any machine holds a live claim.
    pub fn lock_shared(&self) -> io::Result<File> {
        let path = self.root.join("LOCK");
        let file = crate::lock::open(&path)?;
        crate::lock::shared(&file).map_err(at_path(&path))?;
        Ok(file)
    }

    /// Locks the store for this process alone; `None` if another process uses it.
    pub fn try_lock_exclusive(&self) -> anyhow::Result<Option<File>> {
        let path = self.root.join("LOCK");
        let file = crate::lock::open(&path).context("cannot lock the store")?;
        let is_alone = crate::lock::try_exclusive(&file).map_err(at_path(&path)).context("cannot lock the store")?;
        Ok((is_alone && !self.has_live_claims()?).then_some(file))
    }

    /// Marks the store as in use, after removing the scratch files of processes that have crashed.
    pub fn enter(&self) -> anyhow::Result<File> {
        for entry in fs::read_dir(self.root.join("tmp"))? {
            let path = entry?.path();
            if !is_abandoned(&path) {
                continue;
            }
            let removed = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
            match removed {
                // Another process removes it, too, or it is another user's, whose next run removes it.
                Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::PermissionDenied) => {}
                other => other?,
            }
        }
        self.lock_shared().context("cannot lock the store")
    }

    /// Creates a scratch folder on the store's file system, which is removed when dropped.
    pub fn scratch(&self, purpose: &str) -> io::Result<tempfile::TempDir> {
        let prefix = format!("{}-{purpose}-", ProcessId::own().tag());
        tempfile::Builder::new().prefix(&prefix).tempdir_in(self.root.join("tmp"))
    }

    /// Creates a scratch file, which is removed when dropped.
    fn scratch_file(&self) -> io::Result<tempfile::NamedTempFile> {
        new_file(&format!("{}-", ProcessId::own().tag()), &self.root.join("tmp"))
    }

    /// Writes a file durably that must not exist yet: temporary file (in the folder that the next run cleans), fsync,
    /// rename that never replaces.
    fn write_new(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let _in_use = self.lock_shared()?;
        let mut file = self.scratch_file()?;
        file.write_all(bytes).map_err(at_path(path))?;
        file.as_file().sync_all().map_err(at_path(path))?;
        file.persist_noclobber(path).map_err(|error| at_path(path)(error.error))?;
        sync_dir(path.parent().unwrap_or(&self.root))
    }

    /// Writes a file atomically, replacing an existing one.
    pub(crate) fn write_over(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let _in_use = self.lock_shared()?;
        let mut file = self.scratch_file()?;
        file.write_all(bytes).map_err(at_path(path))?;
        file.persist(path).map_err(|error| at_path(path)(error.error))?;
        Ok(())
    }

    fn format_file(&self) -> PathBuf {
        self.root.join("FORMAT")
    }

    /// Fails if the folder, which has no FORMAT, has any file except those of another process that is creating the
    /// store.
    fn refuse_foreign_folder(&self) -> anyhow::Result<()> {
        let entries = fs::read_dir(&self.root).context("cannot open the store")?;
        for entry in entries {
            let is_begun = entry?.file_name().to_string_lossy().starts_with(NEW_FORMAT_PREFIX);
            // Another process may have created the store since the check for FORMAT.
            if !is_begun && !self.exists() {
                let foreign = Failure::new(FailureKind::BadInput, "the folder is not empty and is not a store");
                return Err(foreign.hint("choose another folder with --store").at(&self.root).into());
            }
        }
        Ok(())
    }

    /// Creates FORMAT, the first file of a store. Two processes may do so at once; both write the same line.
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
            Err(error) => Err(error.into()),
            Ok(text) => match text.trim().parse::<u32>() {
                Ok(FORMAT) => Ok(()),
                Ok(version) => Err(Failure::new(
                    FailureKind::World,
                    format!("the store has format {version}, but this program supports format {FORMAT}"),
                )
                .hint("use a newer program, or another folder with --store")
                .at(path)
                .into()),
                Err(_) => Err(Failure::new(FailureKind::BadInput, "this is not a store: FORMAT is not a number")
                    .hint("choose another folder with --store")
                    .at(path)
                    .into()),
            },
        }
    }
}

/// Whether a scratch file's process has crashed: the process is of this machine and has ended, or nothing has changed for
/// longer than any job takes.
fn is_abandoned(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let tag = name.splitn(4, '-').take(3).collect::<Vec<_>>().join("-");
    let changed = fs::symlink_metadata(path).and_then(|meta| meta.modified());
    let is_old = changed.is_ok_and(|at| at.elapsed().is_ok_and(|age| age > MAX_SCRATCH_AGE));
    ProcessId::tag_has_ended(&tag) || is_old
}

/// Adds the path to the message of an error that does not name its file.
fn at_path(path: &Path) -> impl Fn(io::Error) -> io::Error {
    move |error| io::Error::new(error.kind(), format!("{error}: {}", path.display()))
}

/// A temporary file with the permissions that the umask gives to new files; by default it would be private.
fn new_file(prefix: &str, dir: &Path) -> io::Result<tempfile::NamedTempFile> {
    let rights = std::fs::Permissions::from_mode(0o666); // minus the umask
    tempfile::Builder::new().prefix(prefix).permissions(rights).tempfile_in(dir)
}

fn sync_dir(dir: &Path) -> io::Result<()> {
    fs::File::open(dir).and_then(|file| file.sync_all())
}

#[cfg(test)]
mod tests;

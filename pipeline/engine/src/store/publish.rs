//! Publication: blobs first, the record last.

use std::collections::BTreeSet;
use std::fs::{self, File, Permissions};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use anyhow::Context;
use rayon::prelude::*;
use serde_json::Value;
use tempfile::TempPath;

use super::{Manifest, Store, naming, sync_dir};
use crate::Digest;

/// Up to so many files and folders are synced one by one (about 4 ms each on a slow disk); above, one `syncfs` of the
/// whole file system is cheaper, although it also waits for everybody else's writes.
const MAX_SINGLE_SYNCS: usize = 64;

/// What a publication put into the store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Publication {
    /// The digest of the folder (of its manifest).
    pub content: Digest,
    /// The digest of the measurements.
    pub measurements: Digest,
    /// The size of all files together.
    pub size_bytes: u64,
    /// How many files the artifact has.
    pub files: usize,
}

impl Store {
    /// Moves the folder `dir` (on this file system) into the store, with its measurements. `dir` is used up.
    ///
    /// Afterwards all blobs are durable; whoever looks up a record finds nothing new until the record is written.
    pub fn publish(&self, dir: &Path, measurements: &Value) -> anyhow::Result<Publication> {
        let manifest = Manifest::of_folder(dir)?;
        self.place_files(dir, &manifest).context("cannot store the artifact")?;
        let content = self.put_bytes(&manifest.bytes()?).context("cannot store the manifest")?;
        let measurements = self.put_bytes(&measurement_bytes(measurements)?).context("cannot store measurements")?;
        let marker = self.root.join("verified").join(content.to_string());
        File::create(&marker).map_err(naming(&marker))?;
        Ok(Publication { content, measurements, size_bytes: manifest.size_bytes(), files: manifest.files.len() })
    }

    /// Makes every file durable, then moves it to its name, then makes the names durable.
    fn place_files(&self, dir: &Path, manifest: &Manifest) -> io::Result<()> {
        let path_of = |name: &str| dir.join(name);
        let paths: Vec<PathBuf> = manifest.files.iter().map(|file| path_of(&file.path)).collect();
        paths.iter().try_for_each(|path| fs::set_permissions(path, Permissions::from_mode(0o444)))?;
        self.sync(&paths)?;
        for (file, path) in manifest.files.iter().zip(&paths) {
            self.place(TempPath::try_from_path(path)?, &file.sha256, file.size_bytes)?;
        }
        let shards: BTreeSet<PathBuf> =
            manifest.files.iter().filter_map(|file| Some(self.blob_path(&file.sha256).parent()?.to_owned())).collect();
        self.sync(&shards.into_iter().collect::<Vec<_>>())
    }

    fn sync(&self, paths: &[PathBuf]) -> io::Result<()> {
        #[cfg(target_os = "linux")]
        if paths.len() > MAX_SINGLE_SYNCS {
            return Ok(rustix::fs::syncfs(File::open(&self.root)?)?);
        }
        paths.par_iter().try_for_each(|path| sync_dir(path))
    }

    /// A readable form of the measurements that a publication stored.
    pub fn read_measurements(&self, digest: &Digest) -> anyhow::Result<Value> {
        let bytes = self.read_blob(digest).context("cannot read measurements")?;
        serde_json::from_slice(&bytes).context("measurements are not JSON")
    }
}

/// JSON with sorted keys, so that equal measurements have equal digests.
fn measurement_bytes(measurements: &Value) -> anyhow::Result<Vec<u8>> {
    Ok(serde_json::to_vec(measurements)?)
}

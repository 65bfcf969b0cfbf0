//! Publishes artifacts: blobs first, the record last.

use std::collections::BTreeSet;
use std::fs::Permissions;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use anyhow::Context;
use fs_err as fs;
use fs_err::File;
use rayon::prelude::*;
use serde_json::Value;
use tempfile::TempPath;

use super::{Manifest, Store, sync_dir};
use crate::Digest;

/// Up to this number of files and folders are synced one by one (about 4 ms each on a slow disk). For more, one
/// `syncfs` of the whole file system is cheaper, although it waits for the writes of other processes, too.
const MAX_SINGLE_SYNCS: usize = 64;

/// A published artifact.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Publication {
    /// The digest of the artifact's manifest.
    pub content: Digest,
    /// The digest of the measurements.
    pub measurements: Digest,
    /// The total size of the files in bytes.
    pub size_bytes: u64,
    /// The number of files.
    pub files: usize,
}

impl Store {
    /// Moves the folder `dir`, which must be on the store's file system, into the store, together with its
    /// measurements.
    ///
    /// Afterwards all blobs are durable. The artifact becomes visible when its record is written.
    pub fn publish(&self, dir: &Path, measurements: &Value) -> anyhow::Result<Publication> {
        let manifest = Manifest::of_folder(dir)?;
        self.place_files(dir, &manifest).context("cannot store the artifact")?;
        let content = self.put_bytes(&manifest.bytes()?).context("cannot store the manifest")?;
        let measurements = self.put_bytes(&measurement_bytes(measurements)?).context("cannot store measurements")?;
        let blobs = manifest.files.iter().map(|file| &file.sha256).chain([&content, &measurements]);
        self.sync_shards(blobs).context("cannot store the artifact")?;
        let marker = self.root.join("verified").join(content.to_string());
        File::create(marker)?;
        Ok(Publication { content, measurements, size_bytes: manifest.size_bytes(), files: manifest.files.len() })
    }

    /// Makes the files durable and moves them to their blobs' paths.
    fn place_files(&self, dir: &Path, manifest: &Manifest) -> io::Result<()> {
        let path_of = |name: &str| dir.join(name);
        let paths: Vec<PathBuf> = manifest.files.iter().map(|file| path_of(&file.path)).collect();
        paths.iter().try_for_each(|path| fs::set_permissions(path, Permissions::from_mode(0o444)))?;
        self.sync(&paths)?;
        for (file, path) in manifest.files.iter().zip(&paths) {
            self.place(TempPath::try_from_path(path)?, &file.sha256, file.size_bytes)?;
        }
        Ok(())
    }

    /// Makes the names of blobs durable.
    fn sync_shards<'a>(&self, blobs: impl Iterator<Item = &'a Digest>) -> io::Result<()> {
        let shards: BTreeSet<PathBuf> =
            blobs.filter_map(|blob| Some(self.blob_path(blob).parent()?.to_owned())).collect();
        self.sync(&shards.into_iter().collect::<Vec<_>>())
    }

    fn sync(&self, paths: &[PathBuf]) -> io::Result<()> {
        #[cfg(target_os = "linux")]
        if paths.len() > MAX_SINGLE_SYNCS {
            return Ok(rustix::fs::syncfs(File::open(&self.root)?)?);
        }
        paths.par_iter().try_for_each(|path| sync_dir(path))
    }

    /// Reads the measurements of a publication.
    pub fn read_measurements(&self, digest: &Digest) -> anyhow::Result<Value> {
        let bytes = self.read_blob(digest).context("cannot read measurements")?;
        serde_json::from_slice(&bytes).context("measurements are not JSON")
    }
}

/// JSON with sorted keys, because equal measurements must have equal digests.
fn measurement_bytes(measurements: &Value) -> anyhow::Result<Vec<u8>> {
    Ok(serde_json::to_vec(measurements)?)
}

//! Looking up actions: a hit is believed only if everything that it names is there.

use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::{ActionRecord, Manifest, Store, blob};
use crate::{ActionKey, Digest};

/// What the store knows of an action.
#[derive(Debug)]
pub enum Lookup {
    /// It is done, and every file is there.
    Hit(Box<ActionRecord>),
    /// It was never done.
    Miss,
    /// It was done, but something is missing or corrupt: do it again. [`Store::discard`] clears the way.
    Damaged {
        /// What is wrong, for people.
        reason: String,
        /// What to move to quarantine.
        paths: Vec<PathBuf>,
    },
}

impl Store {
    /// Looks up an action. Sizes are compared always; contents unless the marker says that they matched after the
    /// last change of any of the files.
    pub fn lookup(&self, key: &ActionKey) -> Lookup {
        let path = self.record_path(key);
        let damaged = |reason: String| Lookup::Damaged { reason, paths: vec![path.clone()] };
        let record = match self.read_action_record(key) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Lookup::Miss,
            Err(error) => return damaged(format!("the record cannot be read ({error})")),
            Ok(None) => return damaged("the record is damaged or of another version".into()),
            Ok(Some(record)) => record,
        };
        let faults = self.faults(&record.content);
        let faults = faults.into_iter().chain(self.measurement_fault(&record.measurements)).collect::<Vec<_>>();
        match faults.first() {
            None => Lookup::Hit(Box::new(record)),
            Some((_, reason)) => Lookup::Damaged {
                reason: reason.clone(),
                paths: faults
                    .iter()
                    .filter(|(file, _)| file.exists())
                    .map(|(file, _)| file.clone())
                    .chain([path])
                    .collect(),
            },
        }
    }

    /// Moves what a lookup found damaged to quarantine, so that the producer can publish again.
    pub fn discard(&self, paths: &[PathBuf]) -> std::io::Result<()> {
        paths.iter().try_for_each(|path| self.quarantine(path))
    }

    /// The manifest called `content`.
    pub fn manifest(&self, content: &Digest) -> anyhow::Result<Manifest> {
        Manifest::parse(&self.read_blob(content)?)
    }

    /// Blobs of an artifact that are missing or corrupt, each with the reason.
    pub(super) fn faults(&self, content: &Digest) -> Vec<(PathBuf, String)> {
        let manifest = match self.manifest(content) {
            Ok(manifest) => manifest,
            Err(error) => return vec![(self.blob_path(content), format!("the manifest cannot be read ({error:#})"))],
        };
        let marker = self.root.join("verified").join(content.to_string());
        let verified_ns = fs::metadata(&marker).map_or(i128::MIN, |meta| blob::changed_ns(&meta));
        let check = |file: &super::ManifestFile| {
            let path = self.blob_path(&file.sha256);
            let fault = blob_fault(&path, &file.sha256, file.size_bytes, verified_ns)?;
            Some((path, format!("{} {fault}", file.path)))
        };
        let unverified = |file: &super::ManifestFile| {
            fs::symlink_metadata(self.blob_path(&file.sha256))
                .map_or(true, |meta| blob::changed_ns(&meta) >= verified_ns)
        };
        if !manifest.files.iter().any(unverified) {
            return manifest.files.iter().filter_map(check).collect();
        }
        let faults: Vec<_> = manifest.files.par_iter().filter_map(check).collect();
        if faults.is_empty() {
            // Without the marker the next lookup hashes again, which is only slower.
            let _ = File::create(&marker);
        }
        faults
    }

    fn measurement_fault(&self, measurements: &Digest) -> Option<(PathBuf, String)> {
        let error = self.read_blob(measurements).err()?;
        Some((self.blob_path(measurements), format!("the measurements cannot be read ({error})")))
    }
}

/// What is wrong with a blob, if anything. Its contents are read only if it changed at or after `verified_ns`
/// ("at": a change within the clock's tick cannot be told from one before it).
fn blob_fault(path: &Path, digest: &Digest, size_bytes: u64, verified_ns: i128) -> Option<&'static str> {
    let Ok(meta) = fs::symlink_metadata(path) else { return Some("is missing") };
    if !meta.is_file() || meta.len() != size_bytes {
        return Some("has the wrong size");
    }
    let trusted = blob::changed_ns(&meta) < verified_ns;
    (!trusted && !blob::is_whole(path, digest, size_bytes)).then_some("is corrupt")
}

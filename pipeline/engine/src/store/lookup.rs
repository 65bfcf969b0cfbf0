//! Looks up actions. A hit counts only if all of its blobs are present and intact.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::Context;
use fs_err as fs;
use rayon::prelude::*;

use super::{ActionRecord, Manifest, Store, blob};
use crate::{ActionKey, Digest};

/// The result of looking up an action.
#[derive(Debug)]
pub enum Lookup {
    /// The action is done, and all of its files are intact.
    Hit(Box<ActionRecord>),
    /// The store has no record of the action.
    Miss,
    /// The record or a file is missing or corrupt, so the action has to run again after [`Store::discard`].
    Damaged {
        /// The problem, as a message for the user.
        reason: String,
        /// The files to move to quarantine.
        paths: Vec<PathBuf>,
    },
}

impl Store {
    /// Looks up an action. File sizes are always checked. Contents are checked unless the marker shows that they
    /// matched after the last change of any file.
    pub fn lookup(&self, key: &ActionKey) -> Lookup {
        let path = self.record_path(key);
        let damaged = |reason: String| Lookup::Damaged { reason, paths: vec![path.clone()] };
        let record = match self.read_action_record(key) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Lookup::Miss,
            Err(error) => return damaged(format!("the record is unreadable ({error})")),
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

    /// Moves damaged files, as found by a lookup, to quarantine, so that the job can publish again.
    pub fn discard(&self, paths: &[PathBuf]) -> std::io::Result<()> {
        paths.iter().try_for_each(|path| self.quarantine(path))
    }

    /// The manifest with the digest `content`.
    pub fn manifest(&self, content: &Digest) -> anyhow::Result<Manifest> {
        Manifest::parse(&self.read_blob(content)?)
    }

    /// The contents of one file of an artifact, checked against its digest. Needs no view, so it can be read in a store that
    /// cannot be written.
    pub fn read_file(&self, content: &Digest, path: &str) -> anyhow::Result<Vec<u8>> {
        let manifest = self.manifest(content).context("cannot read an artifact's manifest")?;
        let file = manifest.files.iter().find(|file| file.path == path);
        Ok(self.read_blob(&file.with_context(|| format!("the artifact has no file {path}"))?.sha256)?)
    }

    /// The first missing or corrupt file of an artifact, with the problem; `None` if all files are intact.
    pub fn fault(&self, content: &Digest) -> Option<String> {
        self.faults(content).into_iter().next().map(|(_, problem)| problem)
    }

    /// The missing or corrupt blobs of an artifact, each with the problem.
    pub(super) fn faults(&self, content: &Digest) -> Vec<(PathBuf, String)> {
        let manifest = match self.manifest(content) {
            Ok(manifest) => manifest,
            Err(error) => return vec![(self.blob_path(content), format!("the manifest is unreadable ({error:#})"))],
        };
        let marker = self.root.join("verified").join(content.to_string());
        let verified_ns = fs::metadata(&marker).map_or(i128::MIN, |meta| blob::changed_ns(&meta));
        let mut faults = Vec::new();
        let mut unverified = Vec::new();
        for file in &manifest.files {
            let path = self.blob_path(&file.sha256);
            match condition(&path, file.size_bytes, verified_ns) {
                Condition::Trusted => {}
                Condition::Unverified => unverified.push((path, file)),
                Condition::Faulty(fault) => faults.push((path, format!("{} {fault}", file.path))),
            }
        }
        if unverified.is_empty() {
            return faults;
        }
        let corrupt = |(path, file): (PathBuf, &super::ManifestFile)| {
            let is_intact = Digest::of_file(&path).is_ok_and(|found| found == file.sha256);
            (!is_intact).then(|| (path, format!("{} is corrupt", file.path)))
        };
        faults.extend(unverified.into_par_iter().filter_map(corrupt).collect::<Vec<_>>());
        if faults.is_empty() {
            // Without the marker the next lookup hashes again, which only costs time.
            let _ = fs::File::create(&marker);
        }
        faults
    }

    fn measurement_fault(&self, measurements: &Digest) -> Option<(PathBuf, String)> {
        let error = self.read_blob(measurements).err()?;
        Some((self.blob_path(measurements), format!("the measurements are unreadable ({error})")))
    }
}

/// The condition of a blob by its entry in the file system.
enum Condition {
    /// Its contents matched after their last change.
    Trusted,
    /// Its contents have to be read.
    Unverified,
    /// The problem, without reading it.
    Faulty(&'static str),
}

/// The condition of a blob. Its contents have to be read only if it changed at or after `verified_ns`: a change in the same
/// clock tick cannot be distinguished from an earlier one.
fn condition(path: &Path, size_bytes: u64, verified_ns: i128) -> Condition {
    match fs::symlink_metadata(path) {
        Err(_) => Condition::Faulty("is missing"),
        Ok(meta) if !meta.is_file() || meta.len() != size_bytes => Condition::Faulty("has the wrong size"),
        Ok(meta) if blob::changed_ns(&meta) >= verified_ns => Condition::Unverified,
        Ok(_) => Condition::Trusted,
    }
}

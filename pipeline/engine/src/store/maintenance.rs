//! Store maintenance: verification, garbage collection, disk usage.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use fs_err as fs;
use rayon::prelude::*;
use walkdir::WalkDir;

use super::results::is_own;
use super::{ActionRecord, Store};
use crate::{Digest, Failure, FailureKind};

/// A damaged file in the store.
#[derive(Clone, Debug)]
pub struct Damage {
    /// The damaged file.
    pub path: PathBuf,
    /// The problem; for a record, with the name of its job.
    pub message: String,
}

/// What a garbage collection keeps, whatever its age.
#[derive(Clone, Debug, Default)]
pub struct Keep {
    /// The plan ids of jobs.
    pub plan_ids: BTreeSet<String>,
    /// The action keys of results.
    pub keys: BTreeSet<String>,
    /// Files and folders, e.g. of runs.
    pub paths: BTreeSet<PathBuf>,
}

/// The result of a garbage collection: what it removed, or would remove.
#[derive(Clone, Debug, Default)]
pub struct GcReport {
    /// The jobs whose results are removed: node name, wall time of the job in seconds, size in bytes.
    pub jobs: Vec<(String, f64, u64)>,
    /// The number of removed files.
    pub files: usize,
    /// The total size in bytes.
    pub size_bytes: u64,
}

/// The disk usage of one part of the store.
#[derive(Clone, Copy, Debug, Default)]
pub struct Usage {
    /// The number of files.
    pub files: usize,
    /// The total size in bytes.
    pub size_bytes: u64,
}

impl Store {
    /// Hashes every blob and checks the blobs of every record. `repair` moves damaged blobs and the records that need
    /// them to quarantine, so that the next run recomputes them.
    pub fn verify(&self, repair: bool) -> anyhow::Result<Vec<Damage>> {
        let blobs = files_below(&self.root.join("cas"))?;
        let corrupt: Vec<PathBuf> = blobs.into_par_iter().filter(|path| !self.is_sound(path)).collect();
        let mut damages: Vec<Damage> =
            corrupt.iter().map(|path| Damage { path: path.clone(), message: "blob is corrupt".into() }).collect();
        if repair {
            self.discard(&corrupt)?;
        }
        for path in files_below(&self.root.join("records"))? {
            let Some(message) = self.record_damage(&path, &corrupt) else { continue };
            if repair {
                self.quarantine(&path)?;
            }
            damages.push(Damage { path, message });
        }
        Ok(damages)
    }

    /// Whether the digest of a blob's contents matches its name.
    fn is_sound(&self, path: &Path) -> bool {
        let named = |digest: Digest| self.blob_path(&digest) == path;
        Digest::of_file(path).is_ok_and(named)
    }

    /// The problem with a record, if there is one.
    fn record_damage(&self, path: &Path, corrupt: &[PathBuf]) -> Option<String> {
        let read = || -> Option<ActionRecord> { serde_json::from_slice(&fs::read(path).ok()?).ok() };
        let Some(record) = read() else { return Some("record is unreadable".into()) };
        let blobs = self.blobs_of(&record);
        let broken = |blob: &&Digest| {
            let path = self.blob_path(blob);
            corrupt.contains(&path) || !path.exists()
        };
        let message = match &blobs {
            Err(error) => format!("{error:#}"),
            Ok(blobs) => format!("{} of its blobs are missing or corrupt", blobs.iter().filter(broken).count()),
        };
        let is_intact = blobs.is_ok_and(|blobs| !blobs.iter().any(|blob| broken(&blob)));
        (!is_intact).then(|| format!("{}: {message}", record.provenance.node))
    }

    /// Every blob that a record needs: manifest, measurements, files.
    fn blobs_of(&self, record: &ActionRecord) -> anyhow::Result<BTreeSet<Digest>> {
        let manifest = self.manifest(&record.content).context("the manifest is unreadable")?;
        let own = [record.content, record.measurements];
        Ok(manifest.files.iter().map(|file| file.sha256).chain(own).collect())
    }

    /// Removes the records whose plan id and key are not in `keep` and that no run made or used within `max_age`, then
    /// everything that no remaining record needs. The caller holds the store's exclusive lock.
    ///
    /// This includes the views, result links and markers of removed artifacts, all claims and scratch files, and
    /// checkpoints, failures, quarantined files, other run folders and kept programs older than `max_age`.
    pub fn gc(&self, keep: &Keep, max_age: Duration, dry_run: bool) -> anyhow::Result<GcReport> {
        let mut report = GcReport::default();
        let (kept, dropped): (Vec<_>, Vec<_>) = self.whole_records()?.into_iter().partition(|record| {
            // A run may have used the result of a job that another plan made, e.g. with another importer.
            keep.plan_ids.contains(&record.provenance.plan_id)
                || keep.keys.contains(record.key.as_str())
                || !is_older(&self.record_path(&record.key), max_age)
        });
        for record in &dropped {
            report.jobs.push((record.provenance.node.clone(), record.provenance.wall_secs, record.size_bytes));
        }
        report.jobs.sort_by(|a, b| a.0.cmp(&b.0));
        let mut needed = BTreeSet::new();
        for record in &kept {
            needed.extend(self.blobs_of(record).or_else(without_if_damaged)?);
        }
        let mut doomed: Vec<PathBuf> = dropped.iter().map(|record| self.record_path(&record.key)).collect();
        // E.g. the events of a kept run, which name its results and may be the last ones of their jobs.
        let is_kept = |path: &PathBuf| path.ancestors().any(|part| keep.paths.contains(part));
        doomed.extend(self.unneeded_files(&kept, &needed, max_age)?.into_iter().filter(|path| !is_kept(path)));
        for path in &doomed {
            report.files += 1;
            report.size_bytes += fs::symlink_metadata(path).map_or(0, |meta| meta.len());
            if !dry_run {
                fs::remove_file(path)?;
            }
        }
        if !dry_run {
            self.remove_empty_folders()?;
        }
        Ok(report)
    }

    /// All records, or an error if any cannot be read: its blobs would seem unneeded. It may be another user's, or of
    /// another version of the program.
    fn whole_records(&self) -> anyhow::Result<Vec<ActionRecord>> {
        let unreadable = |path: &Path, reason: String| {
            let hint = "give read permission, or move damaged records away with `pipeline cache verify --repair`";
            Failure::new(FailureKind::World, format!("cannot read a record, so nothing is removed ({reason})"))
                .hint(hint)
                .at(path)
        };
        let paths = files_below(&self.root.join("records"))?;
        let read = |path: PathBuf| {
            let bytes = std::fs::read(&path).map_err(|error| unreadable(&path, error.to_string()))?;
            Ok(serde_json::from_slice(&bytes).map_err(|error| unreadable(&path, error.to_string()))?)
        };
        paths.into_iter().map(read).collect()
    }

    /// The files that no kept record needs.
    fn unneeded_files(
        &self,
        kept: &[ActionRecord],
        needed: &BTreeSet<Digest>,
        max_age: Duration,
    ) -> io::Result<Vec<PathBuf>> {
        let needed_blobs: BTreeSet<PathBuf> = needed.iter().map(|digest| self.blob_path(digest)).collect();
        let contents: BTreeSet<String> = kept.iter().map(|record| record.content.to_string()).collect();
        let first_part = |folder: &str, path: &Path| {
            let relative = path.strip_prefix(self.root.join(folder)).ok()?;
            Some(relative.iter().next()?.to_string_lossy().into_owned())
        };
        let shown = |folder: &str, path: &Path| first_part(folder, path).is_some_and(|name| contents.contains(&name));
        let mut files: Vec<PathBuf> = files_below(&self.root.join("cas"))?;
        files.retain(|path| !needed_blobs.contains(path));
        for folder in ["views", "verified"] {
            files.extend(files_below(&self.root.join(folder))?.into_iter().filter(|path| !shown(folder, path)));
        }
        let leads_to_kept = |link: &PathBuf| {
            let target = fs::read_link(link).ok();
            let name = target.as_deref().and_then(Path::file_name);
            name.is_some_and(|name| contents.contains(name.to_string_lossy().as_ref()))
        };
        let mut links = files_below(&self.root.join("results"))?;
        // Files that users put next to the links are kept.
        links.retain(|link| is_own(link) && !leads_to_kept(link));
        files.extend(links);
        files.extend(files_below(&self.root.join("tmp"))?);
        files.extend(files_below(&self.root.join("claims"))?);
        for folder in ["checkpoints", "failures", "quarantine", "runs", "programs"] {
            let old = files_below(&self.root.join(folder))?.into_iter().filter(|path| is_older(path, max_age));
            files.extend(old);
        }
        Ok(files)
    }

    fn remove_empty_folders(&self) -> io::Result<()> {
        for folder in ["cas", "views", "results", "tmp", "checkpoints", "runs"] {
            let path = self.root.join(folder);
            if !path.exists() {
                continue;
            }
            for entry in WalkDir::new(path).min_depth(1).contents_first(true) {
                let entry = entry?;
                if entry.file_type().is_dir() {
                    // Fails for folders that are not empty, which are kept.
                    let _ = fs::remove_dir(entry.path());
                }
            }
        }
        Ok(())
    }

    /// The disk usage of the store's parts, by name of the file or folder in the store's root.
    pub fn usage(&self) -> io::Result<BTreeMap<String, Usage>> {
        let mut usage: BTreeMap<String, Usage> = BTreeMap::new();
        for path in files_below(&self.root)? {
            let relative = path.strip_prefix(&self.root).unwrap_or(&path);
            let part = relative.iter().next().unwrap_or_default().to_string_lossy().into_owned();
            let entry = usage.entry(part).or_default();
            entry.files += 1;
            entry.size_bytes += fs::symlink_metadata(&path).map_or(0, |meta| meta.len());
        }
        Ok(usage)
    }

    /// Marks a record as used now, so that garbage collection by age keeps it.
    pub(crate) fn touch(&self, record: &ActionRecord) {
        let now = rustix::fs::Timespec { tv_sec: 0, tv_nsec: rustix::fs::UTIME_NOW };
        let unchanged = rustix::fs::Timespec { tv_sec: 0, tv_nsec: rustix::fs::UTIME_OMIT };
        let times = rustix::fs::Timestamps { last_access: unchanged, last_modification: now };
        // An error is ignored: the time stamp matters only for garbage collection.
        let _ =
            rustix::fs::utimensat(rustix::fs::CWD, self.record_path(&record.key), &times, rustix::fs::AtFlags::empty());
    }
}

/// No blobs for a record whose manifest is missing or damaged, which the next lookup handles. A manifest that cannot be
/// read now, e.g. without permission, remains an error.
fn without_if_damaged(error: anyhow::Error) -> anyhow::Result<BTreeSet<Digest>> {
    let is_readable = |error: &io::Error| matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::InvalidData);
    let mut failed = error.chain().filter_map(|cause| cause.downcast_ref::<io::Error>());
    if failed.all(is_readable) { Ok(BTreeSet::new()) } else { Err(error) }
}

/// All files and links below `dir`, sorted; none if the folder is missing.
pub(super) fn files_below(dir: &Path) -> io::Result<Vec<PathBuf>> {
    if !dir.exists() {
        return Ok(Vec::new());
    }
    let mut files = Vec::new();
    for entry in WalkDir::new(dir) {
        let entry = entry?;
        if !entry.file_type().is_dir() {
            files.push(entry.into_path());
        }
    }
    files.sort();
    Ok(files)
}

fn is_older(path: &Path, age: Duration) -> bool {
    let modified = fs::symlink_metadata(path).and_then(|meta| meta.modified());
    modified.is_ok_and(|time| time.elapsed().is_ok_and(|elapsed| elapsed >= age))
}

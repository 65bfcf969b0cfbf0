//! Manifests: a folder as a sorted list of files.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use anyhow::{Context, bail, ensure};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use walkdir::WalkDir;

use crate::Digest;

/// The files of a folder, sorted by path. Times, modes and empty folders are not part of an artifact.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    version: u32,
    /// The files, sorted by path.
    pub files: Vec<ManifestFile>,
}

/// One file of a folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ManifestFile {
    /// Relative, separated by `/`.
    pub path: String,
    /// Size in bytes.
    pub size_bytes: u64,
    /// The digest of the contents, which names the blob.
    pub sha256: Digest,
}

impl Manifest {
    /// Hashes every file below `dir`, in parallel.
    ///
    /// Refuses folders without files, links, names that are not UTF-8, and names that differ only by case, because they
    /// collide on other file systems.
    pub fn of_folder(dir: &Path) -> anyhow::Result<Self> {
        let mut paths = Vec::new();
        let mut folded = BTreeMap::new();
        for entry in WalkDir::new(dir).min_depth(1) {
            let entry = entry.context("cannot list the artifact's folder")?;
            let relative = relative_name(dir, entry.path())?;
            ensure!(!entry.path_is_symlink(), "an artifact cannot contain links: {relative}");
            if let Some(other) = folded.insert(relative.to_lowercase(), relative.clone()) {
                bail!("two names in an artifact differ only by case: {other} and {relative}");
            }
            if entry.file_type().is_file() {
                paths.push((relative, entry.into_path()));
            }
        }
        ensure!(!paths.is_empty(), "the stage wrote no file");
        paths.sort();
        let describe = |(relative, path): &(String, PathBuf)| {
            let size_bytes = path.metadata()?.len();
            Ok(ManifestFile { path: relative.clone(), size_bytes, sha256: Digest::of_file(path)? })
        };
        let files: anyhow::Result<_> = paths.par_iter().map(describe).collect();
        Ok(Self { version: 1, files: files.context("cannot hash the artifact")? })
    }

    /// The serialized manifest; its digest is the digest of the folder.
    pub fn bytes(&self) -> anyhow::Result<Vec<u8>> {
        Ok(serde_json::to_vec(self)?)
    }

    /// Parses a manifest. Paths that lead out of the folder are errors.
    pub fn parse(bytes: &[u8]) -> anyhow::Result<Self> {
        let manifest: Self = serde_json::from_slice(bytes).context("not a manifest")?;
        ensure!(manifest.version == 1, "unknown manifest version {}", manifest.version);
        for file in &manifest.files {
            let inside = Path::new(&file.path).components().all(|part| matches!(part, Component::Normal(_)));
            ensure!(inside && !file.path.is_empty(), "unsafe path in a manifest: {:?}", file.path);
        }
        Ok(manifest)
    }

    /// The total size of the files in bytes.
    pub fn size_bytes(&self) -> u64 {
        self.files.iter().map(|file| file.size_bytes).sum()
    }
}

fn relative_name(root: &Path, path: &Path) -> anyhow::Result<String> {
    let parts: Option<Vec<&str>> = path.strip_prefix(root)?.iter().map(|part| part.to_str()).collect();
    Ok(parts.with_context(|| format!("file name is not UTF-8: {}", path.display()))?.join("/"))
}

//! Views: folders of links into `cas`, through which artifacts are read in place.
//!
//! The files of an artifact with a web page are copied instead, because users open, keep and send it: a browser
//! resolves a link and treats its target, which has no extension, as text, and a folder of links cannot leave the
//! store.

use std::io::{self, ErrorKind};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use anyhow::Context;
use fs_err as fs;

use super::{Manifest, Store, blob};
use crate::Digest;

impl Store {
    /// The folder `views/<digest>` with the artifact's files. It is built once, and checked before it is reused.
    ///
    /// The links are relative, so that the store can be moved as a whole.
    pub fn view(&self, content: &Digest) -> anyhow::Result<PathBuf> {
        let manifest = self.manifest(content).context("cannot read an artifact's manifest")?;
        let view = self.root.join("views").join(content.to_string());
        if view.exists() && !is_complete(&view, &manifest) {
            self.quarantine(&view)?;
        }
        if !view.exists() {
            self.build_view(&view, &manifest).context("cannot build the view of an artifact")?;
        }
        Ok(view)
    }

    fn build_view(&self, view: &Path, manifest: &Manifest) -> io::Result<()> {
        let _in_use = self.lock_shared()?;
        let scratch = self.scratch("view")?;
        let building = scratch.path().join("view");
        fs::create_dir(&building)?;
        // Files of a folder are adjacent in a manifest, which is sorted.
        let mut folder = building.clone();
        for file in &manifest.files {
            let link = building.join(&file.path);
            if link.parent().is_some_and(|parent| parent != folder) {
                folder = link.parent().unwrap_or(&building).to_owned();
                fs::create_dir_all(&folder)?;
            }
            match has_page(manifest) {
                true => fs::copy(self.blob_path(&file.sha256), link).map(drop)?,
                false => symlink(link_target(&file.path, &file.sha256), link)?,
            }
        }
        match fs::rename(&building, view) {
            // Another process has built the same view.
            Err(error) if matches!(error.kind(), ErrorKind::DirectoryNotEmpty | ErrorKind::AlreadyExists) => Ok(()),
            other => other,
        }
    }
}

/// Whether the artifact has a web page.
fn has_page(manifest: &Manifest) -> bool {
    manifest.files.iter().any(|file| file.path.ends_with(".html"))
}

/// The target of the link at `path` in a view: up from the folders of `path`, the view and `views`, then into `cas`.
fn link_target(path: &str, digest: &Digest) -> PathBuf {
    let depth = path.matches('/').count() + 2;
    std::iter::repeat_n(Path::new(".."), depth).chain([blob::blob_name(digest).as_path()]).collect()
}

fn is_complete(view: &Path, manifest: &Manifest) -> bool {
    let is_right = |file: &super::ManifestFile| {
        let path = view.join(&file.path);
        match has_page(manifest) {
            true => blob::is_intact(&path, &file.sha256, file.size_bytes),
            false => fs::read_link(path).is_ok_and(|target| target == link_target(&file.path, &file.sha256)),
        }
    };
    manifest.files.iter().all(is_right)
}

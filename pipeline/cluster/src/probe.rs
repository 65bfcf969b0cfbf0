//! Tests whether a store's file system has the properties on which claims and publication rely.

use std::io::Write;
use std::os::unix::fs::FileExt;
use std::path::Path;

use anyhow::{Context, ensure};
use fs_err as fs;

/// Tests the file system of `folder`. Each line names a property that holds; an error names one that does not.
pub fn probe_file_system(folder: &Path) -> anyhow::Result<Vec<&'static str>> {
    let scratch = tempfile::Builder::new().prefix(".pipeline-probe-").tempdir_in(folder).context("cannot write")?;
    let path = |name: &str| scratch.path().join(name);
    fs::write(path("a"), "a")?;
    fs::write(path("b"), "b")?;
    ensure!(fs::hard_link(path("a"), path("b")).is_err(), "a link replaces an existing file");
    fs::hard_link(path("a"), path("c")).context("there are no hard links")?;

    let mut new = tempfile::NamedTempFile::new_in(scratch.path())?;
    new.write_all(b"new")?;
    let refused = new.persist_noclobber(path("b"));
    ensure!(refused.is_err(), "a rename that must not replace a file replaces it");
    ensure!(fs::read(path("b"))? == b"b", "a refused rename changed the file");
    let mut new = tempfile::NamedTempFile::new_in(scratch.path())?;
    new.write_all(b"old beat")?;
    let held = new.persist_noclobber(path("claim")).context("a new file cannot get its name")?;

    fs::rename(path("claim"), path("renamed")).context("an open file cannot be renamed")?;
    ensure!(!path("claim").exists(), "a renamed file is still at its old name");
    fs::write(path("claim"), "next")?;
    held.write_all_at(b"new beat", 0).context("a renamed file cannot be written through its handle")?;
    held.sync_data().context("a file cannot be made durable")?;
    ensure!(fs::read(path("claim"))? == b"next", "a handle follows the name instead of the file");
    ensure!(fs::read(path("renamed"))? == b"new beat", "a write is not visible under the file's new name");

    fs::File::open(scratch.path()).and_then(|dir| dir.sync_all()).context("a folder cannot be made durable")?;
    Ok(vec![
        "names are given once: links and renames never replace a file that must not exist",
        "an open file keeps its content when it is renamed, and a new file takes its name",
        "files and folders are made durable",
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_local_disk_passes() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(probe_file_system(folder.path()).unwrap().len(), 3);
        assert!(fs::read_dir(folder.path()).unwrap().next().is_none(), "the probe leaves nothing behind");
        assert!(probe_file_system(&folder.path().join("missing")).is_err());
    }
}

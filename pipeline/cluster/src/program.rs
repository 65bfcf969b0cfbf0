//! A copy of this program in the store, so that a later build does not change the program of waiting jobs.

use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use anyhow::Context;
use engine::{Digest, Store};
use fs_err as fs;

use crate::wave::Site;

/// The copy of the program that the batch jobs of a run start; `None` if the run is on no cluster.
pub fn program_of(run_dir: &Path) -> Option<PathBuf> {
    let site = fs::read(run_dir.join("slurm/site.json")).ok()?;
    serde_json::from_slice::<Site>(&site).ok().map(|site| site.program)
}

/// Copies this program into the store if it has no copy yet, and returns the path of the copy.
pub fn keep_program(store: &Store) -> anyhow::Result<PathBuf> {
    let own = std::env::current_exe().context("cannot find the program's own file")?;
    // On Linux the link leads to the running image even if the file was replaced.
    let image = PathBuf::from("/proc/self/exe");
    let source = if image.exists() { image } else { own };
    let bytes = fs::read(source)?;
    let folder = store.root().join("programs");
    let path = folder.join(format!("pipeline-{}", Digest::of(&bytes).short()));
    if path.exists() {
        // Garbage collection removes copies that were not needed for long. Fails for the copy of another user.
        let _ = fs::File::open(&path)?.file().set_modified(std::time::SystemTime::now());
    } else {
        fs::create_dir_all(&folder)?;
        let mut file = tempfile::NamedTempFile::new_in(&folder)?;
        file.write_all(&bytes)?;
        file.as_file().set_permissions(std::fs::Permissions::from_mode(0o755))?;
        file.as_file().sync_all()?;
        file.persist(&path)?;
    }
    Ok(path)
}

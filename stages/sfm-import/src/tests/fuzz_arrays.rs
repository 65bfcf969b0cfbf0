//! Damaged outputs of estimators: errors, never panics.

use std::path::Path;

use super::estimators::{Member, megasam_arrays, npy, seen, vggt_arrays, write_archive, write_monst3r};
use super::support::run;
use crate::Params;

/// Number of damaged versions of each file.
const VERSIONS: u64 = 150;
/// Minimum number of versions that must be refused: a third of them is truncated.
const LEAST: usize = 40;

fn imported(dir: &Path) -> anyhow::Result<()> {
    run(dir, &Params { every_nth: 0, ..Params::default() }).map(|_| ())
}

/// Imports damaged versions of every array of an archive. The archive is written again each time, because its checksums would
/// reveal the damage before the array is read.
fn mangle_arrays(name: &str, members: &[Member]) {
    let (dir, array) = (tempfile::tempdir().unwrap(), tempfile::NamedTempFile::new().unwrap());
    let files: Vec<(&str, Vec<u8>)> =
        members.iter().map(|(name, descr, shape, data)| (*name, npy(descr, shape, data))).collect();
    for (at, (member, bytes)) in files.iter().enumerate() {
        std::fs::write(array.path(), bytes).unwrap();
        let refused = support::mangle::refused(array.path(), VERSIONS, |damaged| {
            let mut files = files.clone();
            files[at].1 = std::fs::read(damaged).unwrap();
            write_archive(&dir.path().join(name), &files);
            imported(dir.path())
        });
        assert!(refused > LEAST, "only {refused} of {VERSIONS} damaged arrays {member} of {name} were refused");
    }
}

#[test]
fn mangled_arrays_never_panic() {
    mangle_arrays("predictions.npz", &vggt_arrays(2, seen(28, 14)));
    mangle_arrays("sora_sgd_cvd_hr.npz", &megasam_arrays());
}

#[test]
fn mangled_files_of_monst3r_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    write_monst3r(dir.path(), seen(28, 14));
    for file in ["pred_traj.txt", "pred_intrinsics.txt", "frame_0001.npy", "conf_0.npy", "dynamic_mask_1.png"] {
        let refused = support::mangle::refused(&dir.path().join(file), VERSIONS, |_| imported(dir.path()));
        assert!(refused > LEAST, "only {refused} of {VERSIONS} damaged versions of {file} were refused");
    }
}

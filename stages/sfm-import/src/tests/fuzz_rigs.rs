//! Damaged calibrations of rigs: errors, never panics.

use std::path::Path;

use support::fakes::Fake;

use crate::Params;
use crate::recognise::read;

/// Reads 400 damaged versions of a file of a fake, and checks that a minimum share is refused.
fn mangle(write: impl Fn(&Fake, &Path), fake: &Fake, file: &str, least: usize) {
    let dir = tempfile::tempdir().unwrap();
    write(fake, dir.path());
    let refused = support::mangle::refused(&dir.path().join(file), 400, |_| {
        let capture = read(dir.path(), &Params::default())?;
        capture.problems().into_iter().next().map_or(Ok(()), Err)
    });
    assert!(refused > least, "only {refused} of 400 damaged versions of {file} were refused: is it read at all?");
}

#[test]
fn mangled_calibrations_of_rigs_never_panic() {
    let rig = Fake::small(2, 2);
    mangle(Fake::easy_volcap, &rig, "intri.yml", 100);
    mangle(Fake::easy_volcap, &rig, "extri.yml", 100);
    mangle(Fake::panoptic_sports, &rig, "train_meta.json", 100);
    let with_points = |fake: &Fake, dir: &Path| {
        fake.panoptic_sports(dir);
        super::rigs::write_cloud(&dir.join("init_pt_cld.npz"));
    };
    mangle(with_points, &rig, "init_pt_cld.npz", 100);
    mangle(Fake::panoptic_studio, &rig, "calibration_x.json", 100);
    mangle(Fake::technicolor, &rig, "cameras_parameters.txt", 100);
    mangle(Fake::llff, &rig, "poses_bounds.npy", 50);
    mangle(Fake::nvidia, &Fake::small(12, 12), "poses_bounds.npy", 50);
}

#[test]
fn mangled_files_of_nerfies_never_panic() {
    let dir = super::nerfies::capture(4, super::nerfies::BENT);
    for file in ["dataset.json", "metadata.json", "scene.json", "camera/000002.json", "points.npy"] {
        let refused = support::mangle::refused(&dir.path().join(file), 400, |_| {
            let capture = read(dir.path(), &Params::default())?;
            capture.problems().into_iter().next().map_or(Ok(()), Err)
        });
        assert!(refused > 100, "only {refused} of 400 damaged versions of {file} were refused: is it read at all?");
    }
}

use std::fs::{self, File, FileTimes};
use std::path::Path;
use std::time::{Duration, SystemTime};

use super::{Digest, SourceDigests, SourceError};

#[test]
fn digest_is_sha256_in_hexadecimal() {
    let digest = Digest::of(b"abc");
    let hex = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    assert_eq!(digest.to_string(), hex);
    assert_eq!(Digest::from_hex(hex).unwrap(), digest);
    assert!(Digest::from_hex(&hex.to_uppercase()).is_err(), "one spelling per digest");
    assert!(Digest::from_hex(&hex[1..]).is_err());
}

#[test]
fn folder_digest_depends_on_names_and_contents_only() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("capture");
    fs::create_dir_all(folder.join("images")).unwrap();
    fs::write(folder.join("images/0.png"), "zero").unwrap();
    fs::write(folder.join("poses.json"), "{}").unwrap();
    let digest = || SourceDigests::load(&root.path().join("none"), false).digest(&folder).unwrap();

    let before = digest();
    fs::create_dir(folder.join("empty")).unwrap();
    set_modified(&folder.join("poses.json"), Duration::from_secs(5000));
    assert_eq!(digest(), before);

    fs::rename(folder.join("images/0.png"), folder.join("images/1.png")).unwrap();
    let renamed = digest();
    assert_ne!(renamed, before);
    fs::write(folder.join("images/1.png"), "one!").unwrap();
    assert_ne!(digest(), renamed);
}

#[test]
fn a_missing_source_has_an_error_of_its_own() {
    let root = tempfile::tempdir().unwrap();
    let digests = SourceDigests::load(&root.path().join("cache"), false);
    let gone = root.path().join("lego");
    assert!(matches!(digests.digest(&gone), Err(SourceError::Missing(path)) if path == gone));
}

#[test]
fn links_that_lead_nowhere_are_named() {
    for (name, target) in [("images/0.png", "gone.png"), ("images/own", "own"), ("images/up", "..")] {
        let root = tempfile::tempdir().unwrap();
        fs::create_dir(root.path().join("images")).unwrap();
        let link = root.path().join(name);
        std::os::unix::fs::symlink(target, &link).unwrap();
        let digests = SourceDigests::load(&root.path().join("none"), false);
        let error = digests.digest(root.path()).unwrap_err();
        assert!(matches!(&error, SourceError::Link(path) if *path == link), "{target}: {error}");
    }
}

#[test]
fn cache_is_trusted_for_old_files_only() {
    let root = tempfile::tempdir().unwrap();
    let (file, cache) = (root.path().join("data"), root.path().join("cache"));
    fs::write(&file, "contents").unwrap();
    let digests = SourceDigests::load(&cache, false);
    let digest = digests.digest(&file).unwrap();
    fs::write(&cache, digests.changed_cache().unwrap().unwrap()).unwrap();
    assert!(digests.changed_cache().unwrap().is_none());

    // A planted wrong digest shows whether the row is trusted. The file has just changed, so it must not be.
    plant(&cache, 0);
    assert_eq!(SourceDigests::load(&cache, false).digest(&file).unwrap(), digest);
    // The row of a file that was hashed an hour after its last change is trusted, unless `rehash` is set.
    plant(&cache, 3600);
    assert_ne!(SourceDigests::load(&cache, false).digest(&file).unwrap(), digest);
    assert_eq!(SourceDigests::load(&cache, true).digest(&file).unwrap(), digest);
    // A changed file is always hashed again.
    fs::write(&file, "CONTENTS").unwrap();
    let changed = SourceDigests::load(&cache, false).digest(&file).unwrap();
    assert_eq!(changed, SourceDigests::load(&cache, true).digest(&file).unwrap());
}

#[test]
fn stat_digest_changes_with_a_time_stamp() {
    let root = tempfile::tempdir().unwrap();
    fs::write(root.path().join("a"), "a").unwrap();
    let before = SourceDigests::stat_digest(root.path()).unwrap();
    assert_eq!(SourceDigests::stat_digest(root.path()).unwrap(), before);
    set_modified(&root.path().join("a"), Duration::from_secs(10));
    assert_ne!(SourceDigests::stat_digest(root.path()).unwrap(), before);
}

fn set_modified(path: &Path, ago: Duration) {
    let times = FileTimes::new().set_modified(SystemTime::now() - ago);
    File::options().write(true).open(path).unwrap().set_times(times).unwrap();
}

/// Replaces every digest in the cache with a wrong one, hashed `later_secs` after the file's last change.
fn plant(cache: &Path, later_secs: i64) {
    let mut rows: serde_json::Value = serde_json::from_slice(&fs::read(cache).unwrap()).unwrap();
    for row in rows.as_object_mut().unwrap().values_mut() {
        row["sha256"] = Digest::of(b"planted").to_string().into();
        row["hashed_at_ns"] = (row["stat"]["ctime_ns"].as_i64().unwrap() + later_secs * 1_000_000_000).into();
    }
    fs::write(cache, rows.to_string()).unwrap();
}

//! Archives that try to write outside of their folder, or to fill the disk.

use std::io::{Seek as _, SeekFrom, Write as _};

use support::server::{Answer, Server};
use zip::write::SimpleFileOptions;

use super::{fetched, manifest, request, zipped};
use crate::{Fetched, fetch};

/// The error for an archive, after checking that nothing was written but the archive itself.
fn refused(archive: Vec<u8>, keys: &str) -> String {
    let server = Server::start(move |asked, _| Answer::ranged(asked, &archive, "v1"));
    let outer = tempfile::tempdir().unwrap();
    let root = outer.path().join("data");
    let message = fetched(&manifest(&server.url("/set.zip"), keys), None, &root).unwrap_err().to_string();
    let entries = |dir: &std::path::Path| -> Vec<_> {
        std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().file_name()).collect()
    };
    assert_eq!(entries(outer.path()), ["data"], "{message}");
    assert!(!root.join("set/one").exists() && !root.join("set/two").exists(), "{message}");
    message
}

#[test]
fn paths_outside_of_the_folder_refuse_the_archive() {
    let outside =
        ["../evil", "data/one/../../../evil", "/tmp/evil-of-a-test", "data\\..\\..\\evil", "C:/evil", "a/\0b"];
    for name in outside {
        let message = refused(zipped(&[("data/one/a.png", b"a"), ("data/two_v2/b.png", b"b"), (name, b"evil")]), "");
        assert!(message.contains("a path outside of its folder"), "{name}: {message}");
    }
    assert!(!std::path::Path::new("/tmp/evil-of-a-test").exists());
}

#[test]
fn links_refuse_the_archive() {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    archive.add_symlink("data/one", "/tmp", SimpleFileOptions::default()).unwrap();
    archive.start_file("data/two_v2/b.png", SimpleFileOptions::default()).unwrap();
    let message = refused(archive.finish().unwrap().into_inner(), "");
    assert!(message.contains("contains a link, \"data/one\""), "{message}");
}

#[test]
fn more_bytes_than_declared_refuse_the_archive() {
    let zeros = vec![0; 3_000_000];
    let bomb = zipped(&[("data/one/a.png", &zeros), ("data/two_v2/b.png", b"b")]);
    assert!(bomb.len() < 10_000);
    let message = refused(bomb, "unpacked_bytes = 2000000");
    assert!(message.contains("more than 2000000 bytes"), "{message}");
}

/// An entry that states fewer bytes than it unpacks to.
#[test]
fn entries_that_lie_about_their_size_are_cut_off() {
    let mut archive = zipped(&[("data/one/a.png", &vec![0; 3_000_000]), ("data/two_v2/b.png", b"b")]);
    let stated = 3_000_000_u32.to_le_bytes();
    let places: Vec<usize> = archive.windows(4).enumerate().filter(|(_, it)| *it == stated).map(|(at, _)| at).collect();
    assert!(!places.is_empty(), "the size is stated in the directory");
    let mut cursor = std::io::Cursor::new(&mut archive);
    for at in places {
        cursor.seek(SeekFrom::Start(at as u64)).unwrap();
        cursor.write_all(&1000_u32.to_le_bytes()).unwrap();
    }
    let message = refused(archive, "unpacked_bytes = 2000000");
    assert!(message.contains("more bytes than it states") || message.contains("damaged"), "{message}");
}

#[test]
fn archives_without_the_scene_are_refused() {
    let message = refused(zipped(&[("data/elsewhere/a.png", b"a")]), "");
    assert!(message.contains("has no folder one"), "{message}");
    assert!(refused(b"not an archive".to_vec(), "").contains("not a readable ZIP archive"));
}

/// A single folder at the top is that of the scene only if the archive has no other scenes.
#[test]
fn archives_of_several_scenes_are_not_unpacked_as_one() {
    let server = Server::start(|asked, _| Answer::ranged(asked, &zipped(&[("data/elsewhere/a.png", b"a")]), "v1"));
    let root = tempfile::tempdir().unwrap();
    let message = fetched(&manifest(&server.url("/set.zip"), ""), Some("one"), root.path()).unwrap_err().to_string();
    assert!(message.contains("has no folder one") && !root.path().join("set/one").exists(), "{message}");
}

/// The manifest states no hash, so the damage is found only while unpacking.
#[test]
fn damaged_archives_are_downloaded_again() {
    let good = super::archive();
    let mut flipped = good.clone();
    flipped[1000] ^= 1;
    for (bad, part) in [(flipped, "the archive is damaged"), (good[..5000].to_vec(), "not a readable ZIP archive")] {
        let good = good.clone();
        let server =
            Server::start(move |asked, count| Answer::ranged(asked, if count == 0 { &bad } else { &good }, "v1"));
        let root = tempfile::tempdir().unwrap();
        let manifest = manifest(&server.url("/set.zip"), "");
        let message = fetched(&manifest, None, root.path()).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
        assert!(message.contains("fetch again") && message.contains(".refused"), "{message}");
        assert!(!root.path().join("set/one").exists(), "{message}");
        assert!(matches!(fetched(&manifest, None, root.path()).unwrap()[..], [Fetched::New(_)]));
        assert_eq!(server.asked().len(), 2);
        let left = std::fs::read_dir(root.path().join(".downloads/set")).unwrap().count();
        let beside = std::fs::read_dir(root.path().join("set")).unwrap().count();
        assert_eq!((left, beside), (0, 2), "the refused archive and unfinished folders are removed");
    }
}

/// Two addresses with equal ends: a kept archive belongs to its own address only.
#[test]
fn archives_of_one_name_are_distinguished() {
    let second = zipped(&[("data/one/a.png", b"a"), ("data/two_v2/train/b.png", b"other")]);
    let first = super::archive();
    let server = Server::start(move |asked, _| {
        Answer::ranged(asked, if asked.path.starts_with("/x/") { &first } else { &second }, "v1")
    });
    let root = tempfile::tempdir().unwrap();
    for (path, scene) in [("/x/data.zip", "one"), ("/y/data.zip", "two")] {
        let manifest = manifest(&server.url(path), "");
        let on_event = |_: &crate::Archive, _: crate::Event| ();
        let request = request(&manifest, Some(scene), root.path(), &on_event);
        let outcomes = fetch(&crate::Request { keeps_archives: true, ..request }).unwrap();
        assert!(outcomes.iter().all(Result::is_ok), "{outcomes:?}");
    }
    assert_eq!(std::fs::read(root.path().join("set/two/train/b.png")).unwrap(), b"other");
}

/// Damaged archives are refused or unpacked, without a panic.
#[test]
fn mangled_archives_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("set.zip");
    std::fs::write(&path, zipped(&[("data/one/a.png", &super::noise(500)), ("data/one/b.json", b"{}")])).unwrap();
    let places = [("one".to_owned(), dir.path().join("out/one"))].into();
    let refused = support::mangle::refused(&path, 400, |path| {
        let _ = std::fs::remove_dir_all(dir.path().join("out"));
        crate::fetch::unpack_for_tests(path, &places, 1, 1 << 20).map(|_| ())
    });
    assert!(refused > 150, "only {refused} of 400 damaged archives were refused");
    assert!(std::fs::read_dir(dir.path()).unwrap().count() <= 2, "something was written elsewhere");
}

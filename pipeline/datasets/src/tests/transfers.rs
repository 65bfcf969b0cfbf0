//! Downloads: resumed, retried, compared.

use std::sync::Arc;
use std::time::{Duration, Instant};

use support::server::{Answer, Server};

use super::{archive, fetched, manifest, request};
use crate::files::digest;
use crate::{Fetched, Finding, Manifest, fetch, verify, verify_file};

/// The SHA-256 of some bytes.
fn sha256(bytes: &[u8]) -> String {
    engine::Digest::of(bytes).to_string()
}

/// A server of the archive whose answers `change` changes, and its number of earlier requests.
fn serving(change: impl Fn(&mut Answer, usize) + Send + Sync + 'static) -> Server {
    let file = Arc::new(archive());
    Server::start(move |asked, count| {
        let mut answer = Answer::ranged(asked, &file, "v1");
        change(&mut answer, count);
        answer
    })
}

/// The names of the archives that are stored.
fn stored(root: &std::path::Path) -> Vec<String> {
    let entries = std::fs::read_dir(root.join(".downloads/set")).unwrap();
    entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
fn a_small_archive_is_fetched_once() {
    let server = serving(|_, _| ());
    let root = tempfile::tempdir().unwrap();
    let manifest = manifest(&server.url("/set.zip"), &format!("sha256 = \"{}\"", sha256(&archive())));
    let Fetched::New(record) = fetched(&manifest, None, root.path()).unwrap().remove(0) else { panic!("not fetched") };
    assert!(record.was_known && record.sha256 == sha256(&archive()) && record.size == archive().len() as u64);
    assert_eq!(std::fs::read(root.path().join("set/two/train/b.png")).unwrap(), b"second");
    assert_eq!(record.files.len(), 3);
    assert!(!root.path().join("set/other").exists() && stored(root.path()).is_empty());
    assert!(matches!(fetched(&manifest, None, root.path()).unwrap()[..], [Fetched::Present(_)]));
    assert_eq!(server.asked().len(), 1);
}

#[test]
fn one_scene_is_fetched_alone_and_the_others_later() {
    let server = serving(|_, _| ());
    let root = tempfile::tempdir().unwrap();
    let manifest = manifest(&server.url("/set.zip"), "");
    let fetched_one = fetched(&manifest, Some("two"), root.path()).unwrap();
    assert!(matches!(&fetched_one[..], [Fetched::New(record)] if !record.was_known && record.files.len() == 1));
    assert!(root.path().join("set/two").is_dir() && !root.path().join("set/one").exists());
    fetched(&manifest, None, root.path()).unwrap();
    assert!(root.path().join("set/one/meta.json").is_file());
    let unknown = fetched(&manifest, Some("three"), root.path()).unwrap_err();
    assert!(
        unknown.to_string().contains("has no scene three") && unknown.to_string().contains("one, two"),
        "{unknown}"
    );
}

/// Every answer is cut; each request continues at the byte where the last one ended.
#[test]
fn cut_connections_are_continued() {
    let server = serving(|answer, _| answer.cut_after = Some(100_000));
    let root = tempfile::tempdir().unwrap();
    let manifest = manifest(&server.url("/set.zip"), &format!("sha256 = \"{}\"", &sha256(&archive())[..8]));
    fetched(&manifest, None, root.path()).unwrap();
    let asked = server.asked();
    let froms: Vec<Option<usize>> = asked.iter().map(|asked| asked.from_byte()).collect();
    assert_eq!(froms, [None, Some(100_000), Some(200_000), Some(300_000)]);
    assert!(asked[1..].iter().all(|asked| asked.headers["if-range"] == "\"v1\""));
    assert_eq!(std::fs::read(root.path().join("set/one/train/a.png")).unwrap(), super::noise(300_000));
}

/// The first answer stalls for a minute after 64 KiB; the connection stays open.
#[test]
fn stalled_bodies_are_continued() {
    let server = serving(|answer, count| answer.pause = Duration::from_secs(if count == 0 { 60 } else { 0 }));
    let root = tempfile::tempdir().unwrap();
    let started = Instant::now();
    fetched(&manifest(&server.url("/set.zip"), ""), None, root.path()).unwrap();
    assert!(started.elapsed() < Duration::from_secs(30), "it took {:?}", started.elapsed());
    let froms: Vec<Option<usize>> = server.asked().iter().map(|asked| asked.from_byte()).collect();
    assert_eq!(froms, [None, Some(1 << 16)]);
    assert_eq!(std::fs::read(root.path().join("set/one/train/a.png")).unwrap(), super::noise(300_000));
}

/// The outcomes of the other archives, with their hashes, are returned as well.
#[test]
fn one_failed_archive_does_not_hide_others() {
    let file = archive();
    let server = Server::start(move |asked, _| match asked.path.as_str() {
        "/gone.zip" => Answer::status("404 Not Found"),
        _ => Answer::ranged(asked, &file, "v1"),
    });
    let root = tempfile::tempdir().unwrap();
    let mut manifest = manifest(&server.url("/one.zip"), "");
    for (path, scene) in [("/gone.zip", "gone"), ("/two.zip", "two")] {
        let mut archive = manifest.archive[0].clone();
        (archive.url, archive.scenes) = (server.url(path), vec![scene.into()]);
        manifest.archive.push(archive);
        let mut described = manifest.scene[0].clone();
        (described.name, described.archived_as) = (scene.into(), Some("one".into()));
        manifest.scene.push(described);
    }
    manifest.archive[0].scenes = vec!["one".into()];
    manifest.scene.remove(1);
    let outcomes = fetch(&request(&manifest, None, root.path(), &|_, _| ())).unwrap();
    let new: Vec<_> = outcomes.iter().filter_map(|outcome| outcome.as_ref().ok()).collect();
    assert_eq!((outcomes.len(), new.len()), (3, 2), "{outcomes:?}");
    assert!(new.iter().all(|new| matches!(new, Fetched::New(record) if record.sha256.len() == 64)));
}

#[test]
fn files_of_servers_without_ranges_are_fetched_whole() {
    let file = archive();
    let server =
        Server::start(move |_, count| Answer { cut_after: (count == 0).then_some(50_000), ..Answer::whole(&file) });
    let root = tempfile::tempdir().unwrap();
    fetched(&manifest(&server.url("/set.zip"), ""), None, root.path()).unwrap();
    assert_eq!(server.asked().len(), 2);
}

/// The file is replaced at the server while it is downloaded: bytes of two versions are never mixed.
#[test]
fn a_file_that_changes_is_started_again() {
    let (old, new) = (super::noise(200_000), archive());
    let server = Server::start(move |asked, count| match count {
        0 => Answer { cut_after: Some(90_000), ..Answer::ranged(asked, &old, "old") },
        _ => Answer::ranged(asked, &new, "new"),
    });
    let root = tempfile::tempdir().unwrap();
    fetched(&manifest(&server.url("/set.zip"), ""), None, root.path()).unwrap();
    assert_eq!(std::fs::read(root.path().join("set/two/train/b.png")).unwrap(), b"second");
}

#[test]
fn wrong_hashes_and_sizes_unpack_nothing() {
    let server = serving(|_, _| ());
    let root = tempfile::tempdir().unwrap();
    let refused =
        |keys: &str| fetched(&manifest(&server.url("/set.zip"), keys), None, root.path()).unwrap_err().to_string();
    let wrong = refused("sha256 = \"00ff\"");
    assert!(wrong.contains(&sha256(&archive())) && wrong.contains("00ff"), "{wrong}");
    assert!(refused("size = 5").contains("the manifest states 5"));
    assert!(!root.path().join("set").exists() && stored(root.path()).is_empty());
    // The leftovers of the wrong manifest do not affect a correct one.
    assert!(fetched(&manifest(&server.url("/set.zip"), ""), None, root.path()).is_ok());
}

#[test]
fn redirects_are_followed_and_circles_are_refused() {
    let file = archive();
    let server = Server::start(move |asked, _| match asked.path.as_str() {
        "/old.zip" => Answer { headers: vec!["Location: /new.zip".into()], ..Answer::status("302 Found") },
        "/circle.zip" => Answer { headers: vec!["Location: /circle.zip".into()], ..Answer::status("302 Found") },
        "/gone.zip" => Answer::status("404 Not Found"),
        "/page.zip" => {
            Answer { headers: vec!["Content-Type: text/html; charset=utf-8".into()], ..Answer::whole(b"<html>") }
        }
        _ => Answer::ranged(asked, &file, "v1"),
    });
    let root = tempfile::tempdir().unwrap();
    let refused = |path: &str| fetched(&manifest(&server.url(path), ""), None, root.path()).unwrap_err().to_string();
    for (path, part) in [("/circle.zip", "redirect"), ("/gone.zip", "404"), ("/page.zip", "web page")] {
        let message = refused(path);
        assert!(message.to_lowercase().contains(part) && message.contains(path), "{message}");
    }
    assert!(fetched(&manifest(&server.url("/old.zip"), ""), None, root.path()).is_ok());
}

#[test]
fn busy_servers_are_asked_again() {
    let server = serving(|answer, count| {
        if count < 2 {
            *answer = Answer::status("503 Service Unavailable");
        }
    });
    let root = tempfile::tempdir().unwrap();
    fetched(&manifest(&server.url("/set.zip"), ""), None, root.path()).unwrap();
    let dead = serving(|answer, _| *answer = Answer::status("500 Internal Server Error"));
    let root = tempfile::tempdir().unwrap();
    let message = fetched(&manifest(&dead.url("/set.zip"), ""), None, root.path()).unwrap_err().to_string();
    assert!(message.contains("500") && message.contains("run the same command again"), "{message}");
}

#[test]
fn damage_after_a_fetch_is_found() {
    let server = serving(|_, _| ());
    let root = tempfile::tempdir().unwrap();
    let manifest = manifest(&server.url("/set.zip"), "");
    let of = |name: &str| verify(&manifest, manifest.scene(name).unwrap(), root.path()).unwrap();
    assert_eq!(of("one"), Finding::Absent);
    fetched(&manifest, None, root.path()).unwrap();
    assert_eq!(of("one"), Finding::Fine("1 train images; 2 files as fetched".into()));
    let image = root.path().join("set/one/train/a.png");
    let stated = digest(&image).unwrap();
    std::fs::write(&image, vec![0; stated.0 as usize]).unwrap();
    assert!(matches!(of("one"), Finding::Wrong(wrong) if wrong[0].contains("a.png has changed")));
    std::fs::remove_file(&image).unwrap();
    assert!(matches!(of("one"), Finding::Wrong(wrong) if wrong[0] == "0 train images instead of 1"));
    assert!(matches!(of("two"), Finding::Fine(_)));
}

#[test]
fn scenes_of_one_archive_stay_recorded() {
    let server = serving(|_, _| ());
    let root = tempfile::tempdir().unwrap();
    let manifest = manifest(&server.url("/set.zip"), "");
    let of = |name: &str| match verify(&manifest, manifest.scene(name).unwrap(), root.path()).unwrap() {
        Finding::Fine(text) => text,
        other => panic!("{other:?}"),
    };
    fetched(&manifest, Some("one"), root.path()).unwrap();
    fetched(&manifest, Some("two"), root.path()).unwrap();
    assert!(of("one").ends_with("2 files as fetched") && of("two").ends_with("1 files as fetched"));
    // Records of files that an earlier fetch wrote into a replaced folder are dropped.
    let records = crate::records::read(root.path()).unwrap();
    let mut stale = records[0].clone();
    stale.files.insert("set/one/stale.png".into(), (1, String::new()));
    crate::records::add(root.path(), stale, &[]).unwrap();
    std::fs::remove_dir_all(root.path().join("set/one")).unwrap();
    fetched(&manifest, Some("one"), root.path()).unwrap();
    assert!(of("one").ends_with("2 files as fetched") && of("two").ends_with("1 files as fetched"));
}

/// A manifest of weights, which are stored as they are, without scenes, with further `keys`.
fn weights(server: &Server, keys: &str) -> Manifest {
    let text = format!(
        "manifest = 1\nname = \"w\"\ntitle = \"\"\nhomepage = \"\"\nsource = \"\"\nlicence = \"\"\naccess = \"open\"\n\
         format = \"weights\"\nfolder = \"w\"\n[[archive]]\nurl = \"{}\"\nto = \"a.pth\"\n{keys}\n",
        server.url("/a.pth")
    );
    Manifest::parse(&text, std::path::Path::new("w.toml")).unwrap()
}

#[test]
fn a_file_is_moved_to_a_linked_folder_of_another_disk() {
    use std::os::unix::fs::MetadataExt as _;
    let root = tempfile::tempdir().unwrap();
    let Ok(other) = tempfile::tempdir_in("/dev/shm") else { return support::skip("there is no /dev/shm") };
    let disk = |path: &std::path::Path| std::fs::metadata(path).unwrap().dev();
    if disk(root.path()) == disk(other.path()) {
        return support::skip("temporary files and /dev/shm are on one file system");
    }
    std::os::unix::fs::symlink(other.path(), root.path().join("w")).unwrap();
    let server = Server::start(|asked, _| Answer::ranged(asked, b"weights", "v1"));
    fetched(&weights(&server, ""), None, root.path()).unwrap();
    let names: Vec<_> = std::fs::read_dir(other.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names, ["a.pth"]);
    assert_eq!(std::fs::read(other.path().join("a.pth")).unwrap(), b"weights");
    assert!(std::fs::read_dir(root.path().join(".downloads/w")).unwrap().next().is_none(), "the download is moved");
}

#[test]
fn damaged_files_without_scenes_are_found() {
    let server = Server::start(|asked, _| Answer::ranged(asked, b"weights", "v1"));
    let root = tempfile::tempdir().unwrap();
    let with = |keys: &str| weights(&server, keys);
    let of = |keys: &str| {
        let manifest = with(keys);
        verify_file(&manifest, &manifest.archive[0], root.path()).unwrap().unwrap()
    };
    assert_eq!(of(""), Finding::Absent);
    fetched(&with(""), None, root.path()).unwrap();
    let known = format!("sha256 = \"{}\"", &sha256(b"weights")[..8]);
    assert_eq!(of(""), Finding::Fine("7 bytes, as fetched".into()));
    assert!(matches!(of(&known), Finding::Fine(text) if text.contains("first 8 digits")));
    std::fs::write(root.path().join("w/a.pth"), "garbage").unwrap();
    assert!(matches!(of(&known), Finding::Wrong(wrong) if wrong.len() == 2));
    assert!(matches!(of(""), Finding::Wrong(wrong) if wrong[0].contains("has changed")));
    assert!(matches!(of("size = 8"), Finding::Wrong(wrong) if wrong[0].contains("7 bytes; the manifest states 8")));
    let archive = &manifest("http://127.0.0.1:9/set.zip", "");
    assert!(verify_file(archive, &archive.archive[0], root.path()).unwrap().is_none());
}

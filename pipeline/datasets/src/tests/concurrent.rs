//! Several fetches at once into one data root.

use std::path::Path;
use std::time::Duration;

use engine::Failure;
use support::server::{Answer, Server};

use super::{archive, fetched, manifest, request};
use crate::{Event, Fetched, fetch};

/// A second fetch starts after the download of the first, while that is being unpacked.
#[test]
fn a_fetch_excludes_others_until_it_is_recorded() {
    let file = archive();
    let server = Server::start(move |asked, _| Answer::ranged(asked, &file, "v1"));
    let root = tempfile::tempdir().unwrap();
    let manifest = manifest(&server.url("/set.zip"), "");
    let second = std::sync::Mutex::new(None);
    let on_event = |_: &crate::Archive, event: Event| {
        if event == Event::Unpacking {
            *second.lock().unwrap() = Some(fetched(&manifest, None, root.path()));
        }
    };
    let first = fetch(&request(&manifest, None, root.path(), &on_event));
    let refused = second.into_inner().unwrap().unwrap().unwrap_err().to_string();
    assert!(refused.contains("another fetch") && refused.contains("wait for it"), "{refused}");
    assert!(first.unwrap()[0].is_ok());
    assert!(matches!(fetched(&manifest, None, root.path()).unwrap()[..], [Fetched::Present(_)]));
    assert_eq!(std::fs::read(root.path().join("set/two/train/b.png")).unwrap(), b"second");
    assert_eq!(server.asked().len(), 1);
}

/// Fetches of one archive from eight threads: the archive is downloaded once, and every file is written.
#[test]
fn simultaneous_fetches_download_once() {
    for round in 0..10 {
        let file = archive();
        let server = Server::start(move |asked, _| Answer {
            pause: Duration::from_millis(2),
            ..Answer::ranged(asked, &file, "v1")
        });
        let root = tempfile::tempdir().unwrap();
        let manifest = manifest(&server.url("/set.zip"), "");
        let all = at_once(8, |index| {
            std::thread::sleep(Duration::from_millis(2 * index));
            fetched(&manifest, None, root.path())
        });
        let new = all.iter().filter(|it| matches!(it.as_deref(), Ok([Fetched::New(_)]))).count();
        assert_eq!((new, server.asked().len()), (1, 1), "round {round}: {all:?}");
        let is_fine = |it: &Result<Vec<Fetched>, Failure>| {
            it.as_ref().err().is_none_or(|failure| failure.message.contains("another fetch"))
        };
        assert!(all.iter().all(is_fine), "round {round}: {all:?}");
        assert_eq!(files_below(&root.path().join("set")), 3);
    }
}

/// Each call of `fetch` stands for a process: they share nothing but files.
#[test]
fn simultaneous_fetches_of_several_archives_are_all_recorded() {
    let file = archive();
    let server = Server::start(move |asked, _| Answer::ranged(asked, &file, "v1"));
    let root = tempfile::tempdir().unwrap();
    at_once(16, |index| {
        let mut manifest = manifest(&server.url(&format!("/{index}.zip")), "");
        (manifest.name, manifest.folder) = (format!("set-{index}"), format!("set-{index}").into());
        fetched(&manifest, None, root.path()).unwrap();
    });
    let records = crate::records::read(root.path()).unwrap();
    assert_eq!((records.len(), records.iter().map(|record| record.files.len()).sum::<usize>()), (16, 48));
}

/// The results of `work` on this many threads.
fn at_once<T: Send>(count: u64, work: impl Fn(u64) -> T + Sync) -> Vec<T> {
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..count)
            .map(|index| {
                scope.spawn({
                    let work = &work;
                    move || work(index)
                })
            })
            .collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

fn files_below(folder: &Path) -> usize {
    walkdir::WalkDir::new(folder).into_iter().filter(|entry| entry.as_ref().unwrap().file_type().is_file()).count()
}

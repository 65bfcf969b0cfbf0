//! `data fetch` as users experience it: killed and continued, through a proxy, and suggested by `run` and `inspect`.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use support::fakes::Fake;
use support::server::{Answer, Server};

use crate::product::{Ended, program, root};

/// A manifest of a single archive with the scene `lone`.
fn manifest(dir: &Path, url: &str) -> String {
    let text = format!(
        "manifest = 1\nname = \"set\"\ntitle = \"A set\"\nhomepage = \"https://example.org\"\nsource = \"x\"\n\
         licence = \"free\"\naccess = \"open\"\nformat = \"blender\"\nfolder = \"set\"\n\
         [[archive]]\nurl = \"{url}\"\nscenes = [\"lone\"]\n[[scene]]\nname = \"lone\"\n"
    );
    let path = dir.join("set.toml");
    std::fs::write(&path, text).unwrap();
    path.display().to_string()
}

/// An archive with a stored (not compressed) file of 2 MB, written byte by byte.
fn archive() -> Vec<u8> {
    let mut state = 3_u32;
    let next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    stored("lone/a.bin", &std::iter::repeat_with(next).take(2_000_000).collect::<Vec<u8>>())
}

/// A ZIP archive of one file, stored as it is.
fn stored(name: &str, content: &[u8]) -> Vec<u8> {
    let mut table = [0_u32; 256];
    for (index, entry) in (0_u32..).zip(&mut table) {
        *entry = (0..8).fold(index, |value, _| if value & 1 == 1 { 0xEDB8_8320 ^ (value >> 1) } else { value >> 1 });
    }
    let step = |crc: u32, byte: &u8| table[((crc ^ u32::from(*byte)) & 255) as usize] ^ (crc >> 8);
    let crc = !content.iter().fold(!0, step);
    let size = content.len() as u32;
    let common = |out: &mut Vec<u8>| {
        out.extend([20, 0, 0, 0, 0, 0, 0, 0, 0x21, 0]); // version, flags, stored, time, date
        [crc, size, size].iter().for_each(|value| out.extend(value.to_le_bytes()));
        out.extend((name.len() as u16).to_le_bytes());
        out.extend([0, 0]);
    };
    let mut out = b"PK\x03\x04".to_vec();
    common(&mut out);
    out.extend(name.as_bytes());
    out.extend(content);
    let directory = out.len() as u32;
    out.extend(b"PK\x01\x02\x14\x00");
    common(&mut out);
    out.extend([0; 14]); // no comment, disk 0, attributes, offset 0
    out.extend(name.as_bytes());
    let length = out.len() as u32 - directory;
    out.extend(b"PK\x05\x06\0\0\0\0\x01\0\x01\0");
    [length, directory].iter().for_each(|value| out.extend(value.to_le_bytes()));
    out.extend([0, 0]);
    out
}

/// The program is killed in the middle of a slow download; the next one requests the rest and ends with the same bytes.
#[test]
fn a_killed_download_is_continued() {
    let file = Arc::new(archive());
    let served = file.clone();
    let server = Server::start(move |asked, count| Answer {
        pause: if count == 0 { Duration::from_millis(200) } else { Duration::ZERO },
        ..Answer::ranged(asked, &served, "v1")
    });
    let dir = tempfile::tempdir().unwrap();
    let (own, data) = (manifest(dir.path(), &server.url("/set.zip")), dir.path().join("data"));
    let data_root = data.display().to_string();
    let arguments = ["data", "fetch", &own, "--data-root", &data_root];
    let mut child = program(&arguments).spawn().unwrap();
    // The name of the part starts with digits of the hash of its address, and that of its stamp ends with `.json`.
    let part = || {
        let entries = std::fs::read_dir(data.join(".downloads/set")).into_iter().flatten().flatten();
        entries.map(|entry| entry.path()).find(|path| path.extension().is_some_and(|extension| extension == "part"))
    };
    let length = || part().and_then(|part| std::fs::metadata(part).ok()).map_or(0, |found| found.len());
    let started = std::time::Instant::now();
    while length() < 200_000 && started.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let here = length();
    assert!((200_000..2_000_000).contains(&here), "{here} bytes when it was killed");
    assert!(!data.join("set").exists());
    let ended = Ended::of(program(&arguments)).ok();
    assert!(ended.contains("SHA-256") && ended.contains("recorded"), "{ended}");
    assert_eq!(server.asked()[1].from_byte(), Some(here as usize));
    assert_eq!(std::fs::read(data.join("set/lone/a.bin")).unwrap().len(), 2_000_000);
    assert!(part().is_none());
    let verified = Ended::of(program(&["data", "verify", &own, "--data-root", &data_root])).ok();
    assert!(verified.contains("set/lone: ") && verified.contains("1 files as fetched"), "{verified}");
    std::fs::write(data.join("set/lone/a.bin"), "damaged").unwrap();
    let damaged = Ended::of(program(&["data", "verify", &own, "--data-root", &data_root]));
    assert!(damaged.code == 11 && damaged.stdout.contains("WRONG"), "{}", damaged.stdout);
    std::fs::remove_dir_all(data.join("set/lone")).unwrap();
    let removed = Ended::of(program(&["data", "verify", &own, "--data-root", &data_root]));
    assert!(removed.code == 11 && removed.stdout.contains("set/lone: missing"), "{}", removed.stdout);
}

#[test]
fn the_proxy_of_the_environment_is_used() {
    let file = archive();
    let proxy = Server::start(move |asked, _| Answer::ranged(asked, &file, "v1"));
    let dir = tempfile::tempdir().unwrap();
    let own = manifest(dir.path(), "http://data.invalid/set.zip");
    let mut command = program(&["data", "fetch", &own, "--data-root", &dir.path().display().to_string()]);
    ["HTTP_PROXY", "http_proxy", "ALL_PROXY"].iter().for_each(|name| {
        command.env(name, proxy.url("/"));
    });
    command.env_remove("NO_PROXY").env_remove("no_proxy");
    Ended::of(command).ok();
    assert_eq!(proxy.asked()[0].headers["host"], "data.invalid");
    assert!(dir.path().join("set/lone/a.bin").is_file());
}

#[test]
fn runs_name_the_command_that_fetches_missing_data() {
    let dir = tempfile::tempdir().unwrap();
    let run = |recipe: &str| {
        let mut command = program(&["run"]);
        command.arg(root().join("recipes").join(recipe)).arg("--data-root").arg(dir.path().join("d"));
        Ended::of({
            command.arg("--store").arg(dir.path().join("store"));
            command
        })
    };
    let missing = run("dnerf.toml").stderr;
    assert!(missing.contains("pipeline data fetch dnerf --data-root"), "{missing}");
    let closed = Ended::of(program(&["data", "fetch", "enerf-outdoor/actor1_4"]));
    assert!(closed.code != 0 && closed.stderr.contains("fill in the form"), "{}", closed.stderr);
    let unaccepted = Ended::of(program(&["data", "fetch", "n3v/sear_steak"]));
    assert!(unaccepted.code == 3 && unaccepted.stderr.contains("--accept-licence"), "{}", unaccepted.stderr);
    let unknown = Ended::of(program(&["data", "fetch", "dnerf/nothing"]));
    assert!(unknown.code == 3 && unknown.stderr.contains("it has bouncingballs"), "{}", unknown.stderr);
}

/// The default data root, `data`, is relative.
#[test]
fn every_missing_data_set_is_named_for_relative_roots() {
    let dir = tempfile::tempdir().unwrap();
    let mut command = program(&["run"]);
    command.arg(root().join("recipes/paper-mcgs.toml")).args(["--data-root", "d", "--store", "store"]);
    command.current_dir(dir.path());
    let missing = Ended::of(command).stderr;
    let count = |text: &str| missing.matches(text).count();
    assert_eq!(count("`pipeline data fetch dnerf --data-root d`"), 1, "{missing}");
    assert_eq!(count("hypernerf --data-root d") + count("`pipeline data show hypernerf`"), 1, "{missing}");
}

#[test]
fn captures_are_compared_with_the_manifest() {
    let dir = tempfile::tempdir().unwrap();
    let scene = dir.path().join("lego");
    Fake::small(3, 2).dnerf(&scene);
    let text = Ended::of(program(&["inspect", &scene.display().to_string()])).ok();
    assert!(text.contains("known as    dnerf/lego: WRONG: 2 train images instead of 50"), "{text}");
    assert!(text.contains("flaw        The test images show a different state"), "{text}");
}

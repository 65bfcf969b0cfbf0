//! Downloads from a server on this machine, and hostile archives.

mod archives;
mod concurrent;
mod counts;
mod manifests;
mod transfers;

use std::io::Write as _;
use std::path::Path;
use std::time::Duration;

use engine::Failure;
use zip::write::SimpleFileOptions;

use crate::{Event, Fetched, Manifest, Request, fetch};

/// A ZIP archive of these files.
pub(crate) fn zipped(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, content) in files {
        archive.start_file(*name, SimpleFileOptions::default()).unwrap();
        archive.write_all(content).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

/// Bytes that do not shrink.
pub(crate) fn noise(count: usize) -> Vec<u8> {
    let mut state = 7_u32;
    let next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    std::iter::repeat_with(next).take(count).collect()
}

/// A manifest with the scenes `one` and `two`, and further keys of its archive.
pub(crate) fn manifest(url: &str, keys: &str) -> Manifest {
    let text = format!(
        "manifest = 1\nname = \"set\"\ntitle = \"A set\"\nhomepage = \"https://example.org\"\nsource = \"x\"\n\
         licence = \"free\"\naccess = \"open\"\nformat = \"blender\"\nfolder = \"set\"\n\
         [layout]\nimages = \"{{scene}}/{{split}}/*.png\"\n\
         [[archive]]\nurl = \"{url}\"\nscenes = [\"one\", \"two\"]\n{keys}\n\
         [[scene]]\nname = \"one\"\ntrain = 1\n[[scene]]\nname = \"two\"\narchived_as = \"two_v2\"\n"
    );
    Manifest::parse(&text, Path::new("set.toml")).unwrap()
}

/// The archive that [`manifest`] describes.
pub(crate) fn archive() -> Vec<u8> {
    zipped(&[
        ("data/one/train/a.png", &noise(300_000)),
        ("data/one/meta.json", b"{}"),
        ("data/two_v2/train/b.png", b"second"),
        ("data/other/c.png", b"not wanted"),
    ])
}

/// A request for all scenes, or one.
pub(crate) fn request<'a>(
    manifest: &'a Manifest,
    scene: Option<&'a str>,
    root: &'a Path,
    on_event: &'a (dyn Fn(&crate::Archive, Event) + Sync),
) -> Request<'a> {
    Request {
        manifest,
        scene,
        data_root: root,
        accepts_licence: false,
        keeps_archives: false,
        parallel: 2,
        silence: Duration::from_secs(2),
        on_event,
    }
}

/// Fetches all scenes, or one; returns the first failure.
pub(crate) fn fetched(manifest: &Manifest, scene: Option<&str>, root: &Path) -> Result<Vec<Fetched>, Failure> {
    fetch(&request(manifest, scene, root, &|_, _| ()))?.into_iter().collect()
}

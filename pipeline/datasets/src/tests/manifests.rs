//! Manifests: those of the repository, and faulty ones.

use std::path::Path;

use super::{fetched, manifest};
use crate::{Access, Manifest};

#[test]
fn the_manifests_of_the_repository_are_valid() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data-manifests");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "toml") {
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let manifest = Manifest::parse(&text, &path).unwrap_or_else(|failure| panic!("{failure}"));
        assert_eq!(path.file_stem().unwrap(), manifest.name.as_str());
        assert!(manifest.access == Access::Open || !manifest.by_hand.is_empty(), "{} needs by_hand", manifest.name);
        assert_eq!(manifest.access == Access::Open, !manifest.archive.is_empty(), "{}", manifest.name);
        names.push(manifest.name);
    }
    names.sort();
    let papers = [
        "dnerf",
        "n3v",
        "hypernerf",
        "nerfies",
        "dycheck",
        "enerf-outdoor",
        "mobilestage",
        "cmu-panoptic",
        "vcgs",
        "lpips",
    ];
    assert!(papers.iter().all(|name| names.iter().any(|other| other == name)), "{names:?}");
}

#[test]
fn faulty_manifests_are_refused() {
    let good = "manifest = 1\nname = \"x\"\ntitle = \"\"\nhomepage = \"\"\nsource = \"\"\nlicence = \"\"\naccess = \"open\"\n\
                format = \"colmap\"\nfolder = \"x\"\n[[archive]]\nurl = \"https://x.org/a.zip\"\nscenes = [\"a\"]\n[[scene]]\nname = \"a\"\n";
    let parse = |text: &str| Manifest::parse(text, Path::new("x.toml"));
    assert!(parse(good).is_ok());
    let faults = [
        ("manifest = 1", "manifest = 2", "reads version 1"),
        ("name = \"x\"", "name = \"../x\"", "not the name of a data set"),
        ("name = \"x\"", "name = \"x/y\"", "not the name of a data set"),
        ("name = \"x\"", "name = \"\"", "not the name of a data set"),
        ("folder = \"x\"", "folder = \"../x\"", "not below the data root"),
        ("folder = \"x\"", "folder = \"/x\"", "not below the data root"),
        ("name = \"a\"", "name = \"../a\"", "not the name of a scene"),
        ("https://x.org", "ftp://x.org", "is not an address"),
        ("scenes = [\"a\"]", "scenes = [\"b\"]", "unknown scene b"),
        ("scenes = [\"a\"]", "scenes = [\"a\"]\nsha256 = \"xyz\"", "not hexadecimal"),
        ("scenes = [\"a\"]", "scenes = []", "either scenes or to"),
        ("title", "titel", "titel"),
    ];
    for (from, to, part) in faults {
        let message = parse(&good.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(message.contains(part) && message.contains("x.toml"), "{message}");
    }
}

#[test]
fn licences_and_closed_data_sets_are_explained() {
    let root = tempfile::tempdir().unwrap();
    let mut manifest = manifest("http://127.0.0.1:9/set.zip", "");
    manifest.accept_licence = true;
    let message = fetched(&manifest, None, root.path()).unwrap_err().to_string();
    assert!(message.contains("--accept-licence") && message.contains("free"), "{message}");
    (manifest.access, manifest.by_hand) = (Access::Request, "write to the authors".into());
    let message = fetched(&manifest, None, root.path()).unwrap_err().to_string();
    assert!(message.contains("write to the authors") && message.contains("set"), "{message}");
}

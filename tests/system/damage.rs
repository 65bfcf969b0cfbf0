//! Damaged files are refused or read as something valid; nothing panics.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde_json::Value;
use support::mangle::{mangled, refused};
use walkdir::WalkDir;

use crate::product::World;

/// Damaged versions per file.
const VERSIONS: u64 = 25;
/// Files with the same extension that are damaged per artifact; further ones have the same format.
const FILES_PER_ENDING: usize = 2;

/// A recipe in which some method reads each optional input, on a few small images.
const EVERY_ARTIFACT: &str = r#"
extends = ["@RECIPES@/common/synthetic.toml"]
name = "tiny"
[axes]
scene = ["swinging-arm"]
method = ["kineticgs", "l4dgs", "vcgs"]
seed = [0]
[nodes.capture.params]
width = 24
height = 24
frames = 6
val_views = 1
test_views = 1
samples_per_pixel = 1
points = 60
camera = "arc"
[nodes.train.params]
schedule_scale = 0.0004
l4dgs = { teacher = { iterations = 2 } }
"#;

/// Copies an artifact to a writable folder.
fn copy(from: &Path, to: &Path) {
    for entry in WalkDir::new(from).follow_links(true).into_iter().map(|entry| entry.expect("readable")) {
        let target = to.join(entry.path().strip_prefix(from).expect("below the folder"));
        if entry.file_type().is_dir() {
            std::fs::create_dir_all(target).expect("a folder");
        } else {
            std::fs::write(target, std::fs::read(entry.path()).expect("readable")).expect("a file");
        }
    }
}

/// Up to [`FILES_PER_ENDING`] files of each extension.
fn some_files(dir: &Path) -> Vec<PathBuf> {
    let mut chosen: Vec<PathBuf> = Vec::new();
    for entry in WalkDir::new(dir).sort_by_file_name().into_iter().map(|entry| entry.expect("readable")) {
        let path = entry.into_path();
        let same_ending = chosen.iter().filter(|other| other.extension() == path.extension()).count();
        if path.is_file() && same_ending < FILES_PER_ENDING {
            chosen.push(path);
        }
    }
    chosen
}

#[test]
fn damaged_artifacts_of_every_stage_are_refused_or_read() {
    let world = World::of(EVERY_ARTIFACT);
    world.call("run", &[]).ok();
    let plan: Value = serde_json::from_str(&world.call("plan", &["--json"]).ok()).unwrap();
    let registry = cli::stages();
    let mut stages = BTreeMap::new();
    for job in plan["jobs"].as_object().unwrap().keys() {
        let shown: Value = serde_json::from_str(&world.call("show", &[job, "--json"]).ok()).unwrap();
        let stage = shown["record"]["components"]["stage"].as_str().unwrap().to_owned();
        if stages.contains_key(&stage) {
            continue;
        }
        let dir = tempfile::tempdir().unwrap();
        copy(Path::new(shown["path"].as_str().unwrap()), dir.path());
        let stage_of = registry.get(&stage).unwrap();
        let count: usize =
            some_files(dir.path()).iter().map(|file| refused(file, VERSIONS, |_| stage_of.open(dir.path()))).sum();
        stages.insert(stage, count);
    }
    println!("refused damaged files by stage: {stages:?}");
    // All stages but sfm-import, whose own tests damage its files.
    let expected = registry.stages().map(|stage| stage.id()).filter(|id| *id != "sfm-import");
    assert_eq!(stages.keys().map(String::as_str).collect::<BTreeSet<_>>(), expected.collect());
    assert!(stages.values().all(|refused| *refused > 0), "a stage accepts every file: {stages:?}");
}

#[test]
fn damaged_recipes_are_refused_or_planned() {
    let world = World::tiny();
    let whole = std::fs::read(world.recipe()).unwrap();
    let mut refused = 0;
    for seed in 0..150 {
        std::fs::write(world.recipe(), mangled(&whole, seed)).unwrap();
        let resolved = engine::recipe::resolve(&world.recipe(), &[], &cli::stages(), Path::new("data"));
        let Err(errors) = resolved else { continue };
        refused += 1;
        // Formatting must not panic: positions lie inside of the damaged text.
        assert!(!errors.to_string().is_empty());
    }
    assert!(refused >= 60, "only {refused} of 150 damaged recipes were refused");
}

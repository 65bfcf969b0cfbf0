//! Whatever is damaged on disk is refused or read as something valid; nothing panics.

use std::path::{Path, PathBuf};

use scene::mangle::{mangled, refused};
use serde_json::Value;
use walkdir::WalkDir;

use crate::product::World;

/// Damaged versions of each file.
const VERSIONS: u64 = 25;
/// Files of one ending that are damaged in one artifact: the others are alike.
const FILES_PER_ENDING: usize = 2;

/// A method for every optional input, on few small images.
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
"#;

/// A copy of an artifact that can be written to.
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

/// Some files of each ending.
fn some_files(dir: &Path) -> Vec<PathBuf> {
    let mut chosen: Vec<PathBuf> = Vec::new();
    for entry in WalkDir::new(dir).sort_by_file_name().into_iter().map(|entry| entry.expect("readable")) {
        let path = entry.into_path();
        let alike = chosen.iter().filter(|other| other.extension() == path.extension()).count();
        if path.is_file() && alike < FILES_PER_ENDING {
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
    let mut stages = std::collections::BTreeMap::new();
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
    println!("damaged files that were refused, by stage: {stages:?}");
    // All but sfm-import, which has tests of its own.
    assert!(stages.len() >= 10, "{stages:?}");
    assert!(stages.values().all(|refused| *refused > 0), "a stage reads anything: {stages:?}");
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
        // What is said about it must be printable, with places inside of the damaged text.
        assert!(!errors.to_string().is_empty());
    }
    assert!(refused >= 60, "only {refused} of 150 damaged recipes were refused");
}

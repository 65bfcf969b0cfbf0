//! An edit reruns the jobs that it can influence, and no others.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use engine::{CodeTable, Plan};
use walkdir::WalkDir;

use crate::product::root;
use crate::sources::{ScannedCrate, Sources, read};

/// The plan of the quickstart with this code and these overrides.
fn quickstart(code: CodeTable, overrides: &[&str]) -> Plan {
    plan(&root().join("recipes/quickstart.toml"), code, overrides)
}

fn plan(recipe: &Path, code: CodeTable, overrides: &[&str]) -> Plan {
    let overrides: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
    engine::recipe::resolve(recipe, &overrides, &cli::stages_of(code), Path::new("data"))
        .unwrap_or_else(|errors| panic!("{errors}"))
}

/// The jobs that a change reruns: those with new plan ids.
fn rerun(before: &Plan, after: &Plan) -> BTreeSet<String> {
    let ids: BTreeMap<&str, &str> = before.nodes.iter().map(|node| (&*node.name, &*node.plan_id)).collect();
    assert_eq!(before.nodes.len(), after.nodes.len());
    let changed = after.nodes.iter().filter(|node| ids[&*node.name] != node.plan_id);
    changed.map(|node| node.name.clone()).collect()
}

/// The stages whose own code differs. Their jobs rerun even if all of their inputs stay equal.
fn recoded(before: &Plan, after: &Plan) -> BTreeSet<String> {
    let changed = before.nodes.iter().zip(&after.nodes).filter(|(before, after)| before.code != after.code);
    changed.map(|(node, _)| node.stage.clone()).collect()
}

/// The jobs of a plan whose names satisfy `wanted`.
fn jobs(plan: &Plan, wanted: impl Fn(&str) -> bool) -> BTreeSet<String> {
    plan.nodes.iter().map(|node| node.name.clone()).filter(|name| wanted(name)).collect()
}

/// Appends an item of code to a file.
fn more_code(text: &str) -> String {
    format!("{text}\npub const EDITED: u8 = 1;\n")
}

#[test]
fn a_comment_reruns_nothing() {
    let sources = Sources::copy();
    let before = quickstart(sources.code(), &[]);
    let (rust, wgsl) = (sources.files("rs"), sources.files("wgsl"));
    assert!(rust.len() > 100, "{} files", rust.len());
    for file in rust.iter().chain(&wgsl) {
        std::fs::write(file, format!("// A comment /* with some */ words.\n\n{}\n// and\n", read(file))).unwrap();
    }
    for file in sources.files("md") {
        std::fs::write(&file, read(&file) + "\nMore to read.\n").unwrap();
    }
    assert_eq!(rerun(&before, &quickstart(sources.code(), &[])), BTreeSet::new());
}

/// The Rust files below the crates' `src` folders that the code table leaves out.
fn test_files(sources: &Sources) -> Vec<PathBuf> {
    let left_out = |scanned: ScannedCrate| {
        let files =
            WalkDir::new(scanned.root.join("src")).into_iter().map(|entry| entry.expect("readable").into_path());
        let relative =
            move |path: &Path| path.strip_prefix(&scanned.root).expect("below the root").to_str().map(str::to_owned);
        let counts = move |path: &PathBuf| relative(path).is_some_and(|name| scanned.files.contains_key(&name));
        files.filter(move |path| path.extension().is_some_and(|it| it == "rs") && !counts(path))
    };
    sources.scan().into_values().flat_map(left_out).collect()
}

/// The names of modules that a file declares for its tests only, read line by line.
fn test_modules(text: &str) -> impl Iterator<Item = &str> {
    let declared = text.lines().zip(text.lines().skip(1)).filter(|(above, _)| *above == "#[cfg(test)]");
    declared.filter_map(|(_, line)| line.rsplit_once("mod ").and_then(|(_, name)| name.strip_suffix(';')))
}

#[test]
fn edits_of_test_files_rerun_nothing() {
    let sources = Sources::copy();
    let before = sources.scan();
    let edited = test_files(&sources);
    assert!(edited.len() > 100, "{} files", edited.len());
    for file in &edited {
        std::fs::write(file, more_code(&read(file))).unwrap();
    }
    assert_eq!(sources.scan(), before);

    // Every module that is declared for tests only was among them, whatever its name.
    let counted = before.values().flat_map(|scanned| scanned.files.keys().map(|file| scanned.root.join(file)));
    for file in counted.filter(|file| file.extension().is_some_and(|it| it == "rs")) {
        for name in test_modules(&read(&file)) {
            let is_module = |path: &&PathBuf| {
                let stem = if path.ends_with("mod.rs") { path.parent() } else { Some(path.as_path()) };
                stem.and_then(Path::file_stem).is_some_and(|stem| stem == name)
            };
            assert!(edited.iter().any(|path| is_module(&path)), "{name} of {} is hashed", file.display());
        }
    }
    // The planted fault: an edit of a file that is not a test is detected.
    let trainer = sources.path("stages/training/src/lib.rs");
    std::fs::write(&trainer, more_code(&read(&trainer))).unwrap();
    assert_ne!(sources.scan(), before);
}

#[test]
fn an_edit_reruns_what_it_can_influence() {
    let sources = Sources::copy();
    let before = quickstart(sources.code(), &[]);
    let after = |file: &str| rerun(&before, &quickstart(sources.code_with(file, more_code), &[]));
    let is_static = |name: &str| name.contains("/static3dgs/") || name == "report";
    assert_eq!(after("shaders/src/rasteriser/blending/mod.rs"), jobs(&before, |name| !name.starts_with("capture")));
    assert_eq!(after("stages/training/src/methods/static3dgs/mod.rs"), jobs(&before, is_static));
    assert_eq!(after("stages/table-generation/src/markdown.rs"), jobs(&before, |name| name == "report"));
    assert_eq!(after("stages/sfm-import/src/run.rs"), BTreeSet::new());
    assert_eq!(after("stages/scene-synthesis/src/world.rs"), jobs(&before, |_| true));
    assert_eq!(after("pipeline/engine/src/scheduler/mod.rs"), BTreeSet::new());
    assert_eq!(after("pipeline/cli/src/lib.rs"), BTreeSet::new());

    let loss = |text: &str| text.replace("lambda_dssim: 0.2", "lambda_dssim: 0.3");
    let edited = quickstart(sources.code_with("stages/training/src/shared/rendering.rs", loss), &[]);
    assert_eq!(rerun(&before, &edited), jobs(&before, |name| !name.starts_with("capture")));
}

/// The files of a folder with this extension, relative to the workspace.
fn files_of(folder: &str, extension: &str) -> Vec<String> {
    let files = WalkDir::new(root().join(folder)).into_iter().map(|entry| entry.expect("readable").into_path());
    let relative = |path: PathBuf| path.strip_prefix(root()).expect("below the root").display().to_string();
    files.filter(|path| path.extension().is_some_and(|it| it == extension)).map(relative).collect()
}

#[test]
fn an_edit_of_a_private_kernel_reruns_one_method() {
    let sources = Sources::copy();
    let ci = |code: CodeTable| plan(&root().join("recipes/ci.toml"), code, &[]);
    let before = ci(sources.code());
    let after = |file: &str| rerun(&before, &ci(sources.code_with(file, more_code)));
    let of = |method: &str| jobs(&before, |name| name.contains(&format!("/{method}/")) || name == "report");
    assert!(of("kineticgs").len() > 3 && of("mcgs").len() > 3, "{:?}", of("kineticgs"));
    assert_eq!(after("shaders/src/losses/histogram/mod.rs"), of("kineticgs"));
    assert_eq!(after("shaders/src/networks/layer_norm/layer_norm.wgsl"), of("mcgs"));
    // The planted fault: a kernel that several methods use.
    assert!(after("shaders/src/networks/attention/mod.rs").is_superset(&of("l4dgs")));
    assert!(after("shaders/src/networks/attention/mod.rs").is_superset(&of("kineticgs")));
}

#[test]
fn an_edit_of_a_claim_reruns_only_tables() {
    let sources = Sources::copy();
    let before = quickstart(sources.code(), &[]);
    let claims = files_of("stages/table-generation/claims", "toml");
    assert!(claims.len() > 5, "{claims:?}");
    for file in claims {
        let after = quickstart(sources.code_with(&file, more_code), &[]);
        assert_eq!(rerun(&before, &after), jobs(&before, |name| name == "report"), "{file}");
    }
}

/// Early cutoff spares a job whose inputs turn out equal, unless the job's own code changed.
#[test]
fn an_edit_changes_the_code_of_the_stages_that_run_it() {
    let sources = Sources::copy();
    let before = quickstart(sources.code(), &[]);
    let after = |file: &str| recoded(&before, &quickstart(sources.code_with(file, more_code), &[]));
    let stages = |names: &[&str]| names.iter().map(|name| name.to_string()).collect::<BTreeSet<_>>();
    assert_eq!(after("stages/training/src/trainer/mod.rs"), stages(&["training", "rendering"]));
    assert_eq!(after("stages/training/src/artifact.rs"), stages(&["training", "rendering", "table-generation"]));
    assert_eq!(after("stages/rendering/src/run.rs"), stages(&["rendering"]));
    assert_eq!(after("stages/scene-synthesis/src/run.rs"), stages(&["scene-synthesis"]));
    assert_eq!(after("stages/metric-evaluation/src/run.rs"), stages(&["metric-evaluation", "table-generation"]));
    let readers = stages(&["rendering", "metric-evaluation", "table-generation"]);
    assert_eq!(after("stages/rendering/src/artifact.rs"), readers);
}

#[test]
fn a_value_of_the_recipe_reruns_what_depends_on_it() {
    let code = Sources::copy().code();
    let before = quickstart(code, &[]);
    let after = |overrides: &[&str]| rerun(&before, &quickstart(code, overrides));
    let deformable = |name: &str| name.contains("/deformable4dgs/") || name == "report";
    assert_eq!(after(&["nodes.train.params.deformable4dgs.channels=8"]), jobs(&before, deformable));
    let from_render = |name: &str| !["capture", "coarse", "train"].iter().any(|before| name.starts_with(before));
    assert_eq!(after(&["nodes.render.params.maps=\"all\""]), jobs(&before, from_render));
    assert_eq!(after(&["nodes.train.params.batch=1"]), BTreeSet::new(), "the default value, written explicitly");

    let dir = tempfile::tempdir().unwrap();
    let recipe = dir.path().join("edited.toml");
    let quickstart_path = root().join("recipes/quickstart.toml");
    let rule = "[[set]]\nwhen = { scene = \"swinging-arm\" }\nnodes.train.params.density.max_count = 5000\n";
    std::fs::write(&recipe, format!("extends = [{quickstart_path:?}]\n{rule}")).unwrap();
    let of_scene = |name: &str| name.contains("/swinging-arm/") || name == "report";
    assert_eq!(rerun(&before, &plan(&recipe, code, &[])), jobs(&before, of_scene));
}

//! The crate graph is the data-flow graph, and within a crate sibling modules do not import each other cyclically.

use std::collections::{BTreeMap, BTreeSet};

use cargo_metadata::{DependencyKind, MetadataCommand, Package};
use walkdir::WalkDir;

use crate::imports::{ModuleTree, circles};
use crate::product::root;

/// For each crate, the workspace crates that it may depend on: the stages whose artifacts it reads, the engine, the
/// vocabulary, and the crate that joins the two. Dependencies of tests and benchmarks count, except those on [`SUPPORT`].
const ALLOWED: [(&str, &[&str]); 22] = [
    ("engine", &[]),
    ("scene", &[]),
    ("captures", &["engine", "scene"]),
    ("cluster", &["engine"]),
    ("sweep", &[]),
    ("datasets", &["engine"]),
    ("prepare", &["engine", "scene"]),
    ("support", &[]),
    // `shaders::check` compares kernels in the tests of several crates, and skips where there is no adapter.
    ("shaders", &["scene", SUPPORT]),
    ("scene-synthesis", &["engine", "scene", "captures"]),
    ("sfm-import", &["engine", "scene", "captures"]),
    ("depth-flow-import", &["engine", "scene", "captures", "scene-synthesis"]),
    ("layer-split", &["engine", "scene", "captures", "scene-synthesis", "depth-flow-import"]),
    ("inpaint-import", &["engine", "scene", "captures", "scene-synthesis", "depth-flow-import", "layer-split"]),
    ("feature-import", &["engine", "scene", "captures", "scene-synthesis"]),
    ("momentum-sampling", &["engine", "scene", "captures", "scene-synthesis", "depth-flow-import"]),
    (
        "training",
        &[
            "engine",
            "scene",
            "captures",
            "shaders",
            "scene-synthesis",
            "sfm-import",
            "depth-flow-import",
            "layer-split",
            "inpaint-import",
            "feature-import",
            "momentum-sampling",
        ],
    ),
    (
        "rendering",
        &["engine", "scene", "captures", "shaders", "training", "scene-synthesis", "sfm-import", "feature-import"],
    ),
    ("metric-evaluation", &["engine", "scene", "captures", "rendering", "scene-synthesis", "sfm-import"]),
    ("table-generation", &["engine", "scene", "captures", "training", "rendering", "metric-evaluation"]),
    (
        "cli",
        &[
            "engine",
            "cluster",
            "sweep",
            "datasets",
            "prepare",
            "scene",
            "shaders",
            "scene-synthesis",
            "sfm-import",
            "depth-flow-import",
            "layer-split",
            "inpaint-import",
            "feature-import",
            "momentum-sampling",
            "training",
            "rendering",
            "metric-evaluation",
            "table-generation",
        ],
    ),
    ("tests", &["cli", "engine", "scene", "scene-synthesis", "training"]),
];

/// For each stage, the items that the product code of other stages may use: types of its artifact. `rendering` must
/// also evaluate a trained model, so it uses the player with its edits, the choice of a device and the 8-bit rounding of
/// `training`, and the embeddings of prompts that `feature-import` reads.
const SHARED_ITEMS: [(&str, &[&str]); 8] = [
    ("depth-flow-import", &["Priors", "FlowPrior"]),
    ("layer-split", &["Layers"]),
    ("inpaint-import", &["Background", "FilledView"]),
    ("feature-import", &["Features", "TextEmbeddings"]),
    ("momentum-sampling", &["Particles"]),
    (
        "training",
        &[
            "Model",
            "ModelHeader",
            "LargestGradient",
            "PhaseInfluence",
            "INERT_SHARE",
            "Player",
            "Edit",
            "compute_on",
            "model_work",
        ],
    ),
    ("rendering", &["Renders", "RenderedView", "SemanticMaps", "SurfaceMaps"]),
    (
        "metric-evaluation",
        &["Metrics", "Metric", "MaskName", "Score", "Trivial", "TrivialOverlap", "MeanImage", "Degenerate"],
    ),
];

/// Helpers for tests: the tests of every crate may use them, product code must not.
const SUPPORT: &str = "support";

fn packages() -> Vec<Package> {
    MetadataCommand::new().no_deps().exec().expect("cargo metadata runs").packages
}

/// Every dependency between workspace crates, by crate. Those of tests on [`SUPPORT`] are left out.
fn workspace_dependencies() -> BTreeMap<String, BTreeSet<String>> {
    let packages = packages();
    let members: BTreeSet<String> = packages.iter().map(|package| package.name.to_string()).collect();
    let of_package = |package: &Package| {
        let inner = package.dependencies.iter().filter(|dependency| members.contains(&dependency.name));
        let kept = inner.filter(|dependency| match dependency.kind {
            DependencyKind::Development => dependency.name != SUPPORT,
            kind => kind != DependencyKind::Unknown,
        });
        (package.name.to_string(), kept.map(|dependency| dependency.name.clone()).collect())
    };
    packages.iter().map(of_package).collect()
}

/// The edges of `graph` that `ALLOWED` does not list.
fn forbidden(graph: &BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    let allowed: BTreeMap<&str, &[&str]> = ALLOWED.into_iter().collect();
    let edges = graph.iter().flat_map(|(from, tos)| tos.iter().map(move |to| (from.as_str(), to.as_str())));
    let refused = edges.filter(|(from, to)| !allowed.get(from).is_some_and(|list| list.contains(to)));
    refused.map(|(from, to)| format!("{from} → {to}")).collect()
}

/// Product code of every stage: its sources without tests, by name of the stage.
fn stage_sources() -> Vec<(String, String)> {
    let stages = std::fs::read_dir(root().join("stages")).expect("the stages are listed");
    let source = |stage: std::io::Result<std::fs::DirEntry>| {
        let stage = stage.expect("the stage is readable").path();
        let is_test = |path: &str| path == "tests" || path == "tests.rs" || path.ends_with("_tests.rs");
        let files = WalkDir::new(stage.join("src"))
            .into_iter()
            .filter_entry(|it| !it.file_name().to_str().is_some_and(is_test));
        let rust = files.filter_map(Result::ok).filter(|it| it.path().extension().is_some_and(|ending| ending == "rs"));
        let text = |file: walkdir::DirEntry| {
            let text = std::fs::read_to_string(file.path()).expect("the source is readable");
            text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default().to_owned()
        };
        (stage.file_name().expect("a name").to_string_lossy().into_owned(), rust.map(text).collect())
    };
    stages.map(source).collect()
}

/// The first path segments after `name::` in a text, e.g. `a` and `b` for `name::{a, b::c}`.
fn items_of<'a>(name: &str, text: &'a str) -> Vec<&'a str> {
    let is_word = |symbol: char| symbol.is_alphanumeric() || symbol == '_';
    let prefix = format!("{name}::");
    let places = text.match_indices(&prefix).filter(|(at, _)| !text[..*at].ends_with(|it| is_word(it) || it == ':'));
    let items = places.flat_map(|(at, _)| {
        let rest = &text[at + prefix.len()..];
        let list = rest.strip_prefix('{').map_or(rest, |list| list.split('}').next().unwrap_or_default());
        let count = if rest.starts_with('{') { usize::MAX } else { 1 };
        list.split(',').take(count).map(str::trim_start)
    });
    items.map(|item| item.split(|it| !is_word(it)).next().unwrap_or_default()).filter(|item| !item.is_empty()).collect()
}

/// The uses of items of other stages that `SHARED_ITEMS` does not list.
fn forbidden_items(sources: &[(String, String)]) -> Vec<String> {
    let dependencies = workspace_dependencies();
    let mut found = BTreeSet::new();
    for (user, text) in sources {
        for stage in dependencies[user].iter().filter(|name| sources.iter().any(|(stage, _)| stage == *name)) {
            let shared = SHARED_ITEMS.iter().find(|(name, _)| name == stage).map_or(&[][..], |(_, items)| items);
            let items = items_of(&stage.replace('-', "_"), text);
            let refused = items.into_iter().filter(|item| !shared.contains(item));
            found.extend(refused.map(|item| format!("{user} uses {item} of {stage}")));
        }
    }
    found.into_iter().collect()
}

#[test]
fn crates_depend_only_along_the_data_flow() {
    let graph = workspace_dependencies();
    assert_eq!(forbidden(&graph), Vec::<String>::new(), "crate dependencies outside of the data flow");
    let crates: BTreeSet<&str> = graph.keys().map(String::as_str).collect();
    assert_eq!(crates, ALLOWED.iter().map(|(name, _)| *name).collect(), "ALLOWED lists every crate once");
}

#[test]
fn a_forbidden_dependency_is_noticed() {
    let mut graph = workspace_dependencies();
    graph.get_mut("engine").expect("engine exists").insert("scene".into());
    graph.get_mut("training").expect("training exists").insert(SUPPORT.into());
    assert_eq!(forbidden(&graph), ["engine → scene", "training → support"]);
}

#[test]
fn modules_import_without_circles() {
    let mut found = Vec::new();
    let mut modules = 0;
    for package in packages() {
        let name = package.name.to_string();
        let source = package.manifest_path.with_file_name("src").into_std_path_buf();
        if !source.join("lib.rs").is_file() {
            continue;
        }
        let tree = ModuleTree::of_crate(&source);
        modules += tree.len();
        found.extend(circles(&tree).iter().map(|circle| format!("{name}: {circle}")));
    }
    assert!(modules > 300, "only {modules} modules were found below {}", root().display());
    assert_eq!(found, Vec::<String>::new(), "modules that import each other in a circle");
}

#[test]
fn stages_share_only_types_of_their_artifacts() {
    let sources = stage_sources();
    assert_eq!(forbidden_items(&sources), Vec::<String>::new(), "items that are not part of an artifact");
    let uses = |stage: &str, item: &&str| {
        let name = stage.replace('-', "_");
        sources.iter().any(|(user, text)| user != stage && items_of(&name, text).contains(item))
    };
    for (stage, items) in SHARED_ITEMS {
        let unused: Vec<_> = items.iter().filter(|item| !uses(stage, item)).collect();
        assert!(unused.is_empty(), "no stage uses {unused:?} of {stage}");
    }
}

#[test]
fn a_forbidden_item_is_noticed() {
    let mut sources = stage_sources();
    let user = sources.iter_mut().find(|(stage, _)| stage == "layer-split").expect("layer-split exists");
    user.1 += "use depth_flow_import::{Priors, flow::consistent};";
    assert_eq!(forbidden_items(&sources), ["layer-split uses flow of depth-flow-import"]);
}

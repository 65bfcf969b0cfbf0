//! The crate graph is the data-flow graph; nothing else may depend on anything else.

use std::collections::{BTreeMap, BTreeSet};

use cargo_metadata::{DependencyKind, MetadataCommand};

/// For each crate, the workspace crates that it may depend on: the stages whose artifacts it reads, the engine, and
/// the vocabulary.
const ALLOWED: [(&str, &[&str]); 17] = [
    ("engine", &[]),
    ("scene", &[]),
    ("needs", &[]),
    ("shaders", &["scene", "needs"]),
    ("scene-synthesis", &["engine", "scene"]),
    ("sfm-import", &["engine", "scene", "needs"]),
    ("depth-flow-import", &["engine", "scene", "scene-synthesis", "needs"]),
    ("layer-split", &["engine", "scene", "scene-synthesis", "depth-flow-import"]),
    ("inpaint-import", &["engine", "scene", "scene-synthesis", "depth-flow-import", "layer-split"]),
    ("feature-import", &["engine", "scene", "scene-synthesis"]),
    ("momentum-sampling", &["engine", "scene", "scene-synthesis", "depth-flow-import"]),
    (
        "training",
        &[
            "engine",
            "scene",
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
    ("rendering", &["engine", "scene", "shaders", "training", "scene-synthesis", "sfm-import"]),
    ("metric-evaluation", &["engine", "scene", "rendering", "scene-synthesis", "sfm-import", "needs"]),
    ("table-generation", &["engine", "scene", "training", "rendering", "metric-evaluation"]),
    (
        "cli",
        &[
            "engine",
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
    ("tests", &["cli", "engine", "scene", "scene-synthesis", "training", "needs"]),
];

/// Every dependency between workspace crates (tests and benchmarks included), by crate.
fn workspace_dependencies() -> BTreeMap<String, BTreeSet<String>> {
    let metadata = MetadataCommand::new().no_deps().exec().expect("cargo metadata runs");
    let members: BTreeSet<String> = metadata.packages.iter().map(|package| package.name.to_string()).collect();
    let of_package = |package: &cargo_metadata::Package| {
        let inner = package.dependencies.iter().filter(|dependency| members.contains(&dependency.name));
        let kept = inner.filter(|dependency| dependency.kind != DependencyKind::Unknown);
        (package.name.to_string(), kept.map(|dependency| dependency.name.clone()).collect())
    };
    metadata.packages.iter().map(of_package).collect()
}

/// The edges of `graph` that `ALLOWED` does not list.
fn forbidden(graph: &BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    let allowed: BTreeMap<&str, &[&str]> = ALLOWED.into_iter().collect();
    let edges = graph.iter().flat_map(|(from, tos)| tos.iter().map(move |to| (from.as_str(), to.as_str())));
    let refused = edges.filter(|(from, to)| !allowed.get(from).is_some_and(|list| list.contains(to)));
    refused.map(|(from, to)| format!("{from} → {to}")).collect()
}

#[test]
fn crates_depend_only_along_the_data_flow() {
    let graph = workspace_dependencies();
    assert_eq!(forbidden(&graph), Vec::<String>::new(), "crate dependencies outside of the data flow");
    let unknown: Vec<_> = graph.keys().filter(|name| !ALLOWED.iter().any(|(known, _)| known == name)).collect();
    assert!(unknown.is_empty(), "crates without a place in the graph: {unknown:?}");
}

#[test]
fn a_forbidden_dependency_is_noticed() {
    let mut graph = workspace_dependencies();
    graph.get_mut("engine").expect("engine exists").insert("scene".into());
    assert_eq!(forbidden(&graph), ["engine → scene"]);
}

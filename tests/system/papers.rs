//! The recipes of the papers plan on every data set that they name, with fakes of its layout.

use std::collections::BTreeSet;
use std::path::Path;

use engine::{Node, Plan};

use crate::product::root;

const PAPERS: [&str; 5] = ["kineticgs", "l4dgs", "mcgs", "phys4dgs", "vcgs"];

pub(crate) fn plan(paper: &str, data_root: &Path) -> Plan {
    let recipe = root().join(format!("recipes/paper-{paper}.toml"));
    engine::recipe::resolve(&recipe, &[], &cli::stages(), data_root)
        .unwrap_or_else(|errors| panic!("{paper}:\n{errors}"))
}

/// The imports of a plan.
fn imports(plan: &Plan) -> impl Iterator<Item = &Node> {
    plan.nodes.iter().filter(|node| node.stage == "sfm-import")
}

/// The folder that an import reads, below the data root.
fn source(node: &Node) -> &str {
    node.params["source"].as_str().expect("a folder")
}

/// Whether the plan could read the capture: its work is then known. Models of COLMAP are left to the import.
fn is_read(node: &Node) -> bool {
    node.work.is_some() || node.params["format"] == "colmap"
}

#[test]
fn paper_recipes_plan_on_fakes_of_every_data_set() {
    let data = tempfile::tempdir().unwrap();
    support::fakes::papers(data.path());
    let mut sets = BTreeSet::new();
    for paper in PAPERS {
        let plan = plan(paper, data.path());
        for node in imports(&plan) {
            assert!(data.path().join(source(node)).is_dir(), "{paper}: there is no fake of {}", source(node));
            assert!(is_read(node), "{paper}: {} cannot be read", node.name);
            sets.extend(source(node).split('/').next().map(str::to_owned));
        }
        assert!(imports(&plan).count() >= 8, "{paper}");
    }
    let all = [
        "cmu-panoptic-hd",
        "dnerf",
        "dycheck",
        "enerf-outdoor",
        "generated",
        "hypernerf",
        "mobilestage",
        "n3v",
        "nerfies",
    ];
    assert_eq!(sets, all.map(str::to_owned).into());
    // A damaged capture is noticed: its work is unknown.
    std::fs::remove_file(data.path().join("mobilestage/dance3/images/05/000700.jpg")).unwrap();
    let plan = plan("phys4dgs", data.path());
    let unread: Vec<&str> = imports(&plan).filter(|node| !is_read(node)).map(|node| node.name.as_str()).collect();
    assert_eq!(unread, ["capture/dance3"]);
}

/// A manifest states where to get the data that a recipe reads, and `data fetch` puts it into the folder that the
/// recipe reads.
#[test]
fn every_capture_of_a_paper_is_in_a_manifest() {
    let manifests: Vec<String> = std::fs::read_dir(root().join("data-manifests"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "toml"))
        .map(|path| std::fs::read_to_string(path).unwrap())
        .collect();
    let folder = |text: &str| toml::from_str::<toml::Table>(text).unwrap()["folder"].as_str().unwrap().to_owned();
    for paper in PAPERS {
        for node in imports(&plan(paper, Path::new("nowhere"))) {
            let (set, scene) = source(node).split_once('/').expect("data set and scene");
            let found = manifests.iter().find(|text| folder(text) == set);
            let found = found.unwrap_or_else(|| panic!("{paper}: no manifest has the folder {set}"));
            let is_numbered = scene.starts_with("video-"); // "video-01 to video-15"
            assert!(is_numbered || found.contains(scene), "{paper}: the manifest of {set} does not know {scene}");
        }
    }
}

use std::collections::{BTreeMap, BTreeSet};

use serde_json::json;

use super::{Node, Plan, PlanInput, matches_pattern};

/// A node that reads the nodes with the given indices.
pub(crate) fn node(name: &str, producers: &[usize]) -> Node {
    Node {
        name: name.into(),
        template: name.split('/').next().unwrap().into(),
        stage: "test-list".into(),
        coordinates: BTreeMap::new(),
        params: json!({}),
        inputs: vec![PlanInput {
            port: "texts".into(),
            artifact: ("text".into(), 1),
            many: true,
            measurements: Default::default(),
            producers: producers.to_vec(),
        }],
        sources: Vec::new(),
        threads: 1,
        work: None,
        on_device: false,
        output: ("text".into(), 1),
        unused_sources: Default::default(),
        code: BTreeMap::new(),
        decisions: Vec::new(),
        plan_id: name.into(),
    }
}

/// Two captures, two trainings with a rendering each, and a table of all renderings.
pub(crate) fn diamond() -> Plan {
    let nodes = vec![
        node("capture/ball", &[]),
        node("capture/lego", &[]),
        node("train/ball/mcgs", &[0]),
        node("train/lego/mcgs", &[1]),
        node("render/ball/mcgs", &[0, 2]),
        node("render/lego/mcgs", &[1, 3]),
        node("table", &[4, 5]),
    ];
    Plan {
        recipe: "diamond".into(),
        nodes,
        origins: BTreeMap::new(),
        left_out: Vec::new(),
        device: Default::default(),
        changes: Vec::new(),
    }
}

fn set(indices: &[usize]) -> BTreeSet<usize> {
    indices.iter().copied().collect()
}

#[test]
fn ancestors_and_descendants_follow_the_edges() {
    let plan = diamond();
    assert_eq!(plan.with_ancestors(&set(&[4])), set(&[0, 2, 4]));
    assert_eq!(plan.with_descendants(&set(&[3])), set(&[3, 5, 6]));
    assert_eq!(plan.with_descendants(&set(&[])), set(&[]));
    assert_eq!(plan.index_of("table"), Some(6));
    assert_eq!(plan.index_of("tab"), None);
}

#[test]
fn the_graph_has_all_nodes_and_edges_from_producer_to_consumer() {
    let graph = diamond().graph();
    assert_eq!((graph.node_count(), graph.edge_count()), (7, 8));
    let order = petgraph::algo::toposort(&graph, None).unwrap();
    assert_eq!(graph[order[6]], 6);
    assert!(graph.edge_indices().all(|edge| { graph.edge_endpoints(edge).is_some_and(|(from, to)| from < to) }));
}

#[test]
fn patterns_match_whole_parts_from_the_front() {
    let name = "train/lego/mcgs/0";
    let matching =
        ["train", "train/", "train/lego", "train/*/mcgs*", "*/lego", "tr*n/l?go/*/0", "train/lego/mcgs/0", "*", "t**n"];
    let others =
        ["trai", "train/leg", "lego", "train/*/mc", "train/lego/mcgs/0/x", "train//mcgs", "", "tr?n", "train/?"];
    assert!(matching.iter().all(|pattern| matches_pattern(pattern, name)));
    assert!(!others.iter().any(|pattern| matches_pattern(pattern, name)));
    assert!(matches_pattern("*é?", "caféx"));
}

#[test]
fn a_pattern_without_match_suggests_the_nearest_node() {
    let plan = diamond();
    let select = |patterns: &[&str]| plan.select(&patterns.iter().map(|p| p.to_string()).collect::<Vec<_>>());
    assert_eq!(select(&[]).unwrap().len(), 7);
    assert_eq!(select(&["train/*/mcgs", "table"]).unwrap(), set(&[2, 3, 6]));
    let error = select(&["table", "trian"]).unwrap_err();
    assert_eq!(error.to_string(), "no job matches `trian`; did you mean `train`?");
    assert_eq!(select(&["zzz"]).unwrap_err().to_string(), "no job matches `zzz`");
    let slash = "no job matches `t*mcgs`; * and ? do not match a slash: write one * for every part of a name like";
    assert_eq!(select(&["t*mcgs"]).unwrap_err().to_string(), format!("{slash} train/ball/mcgs"));
    let plan = Plan { left_out: vec!["teacher/ball/mcgs".into()], ..plan };
    let left_out = plan.select(&["teacher/*/mcgs".into()]).unwrap_err().to_string();
    let reason = "teacher/ball/mcgs is left out, because no job needs it or it would repeat another";
    assert_eq!(left_out, format!("no job matches `teacher/*/mcgs`; {reason}"));
}

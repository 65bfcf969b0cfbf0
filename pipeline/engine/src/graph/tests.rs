use std::collections::BTreeMap;

use super::{NodeState, dot, mermaid};
use crate::plan::tests::diamond;

#[test]
fn dot_draws_every_job_and_edge() {
    let states = BTreeMap::from([(0, NodeState::Cached), (2, NodeState::Failed)]);
    let text = dot(&diamond(), &states, false);
    assert!(text.starts_with("digraph \"diamond\" {\n") && text.ends_with("}\n"));
    assert!(text.contains("  n0 [label=\"capture/ball\\ntest-list\", fillcolor=\"#c8e6c9\"];\n"), "{text}");
    assert!(text.contains("n2 [label=\"train/ball/mcgs\\ntest-list\", fillcolor=\"#ffcdd2\"]"));
    assert_eq!(text.matches(" -> ").count(), 8);
    assert!(text.contains("  n2 -> n4;\n"));
}

#[test]
fn mermaid_draws_every_job_and_edge() {
    let text = mermaid(&diamond(), &BTreeMap::from([(6, NodeState::Planned)]), false);
    assert!(text.starts_with("flowchart LR\n  n0[\"capture/ball<br/>test-list\"]:::unknown\n"), "{text}");
    assert!(text.contains("n6[\"table<br/>test-list\"]:::planned\n"));
    assert_eq!(text.matches(" --> ").count(), 8);
    assert_eq!(text.matches("classDef").count(), 2);
}

#[test]
fn collapsed_templates_count_their_jobs_and_show_the_worst_state() {
    let states = BTreeMap::from([(0, NodeState::Cached), (1, NodeState::Blocked), (2, NodeState::Running)]);
    let text = dot(&diamond(), &states, true);
    assert!(
        text.contains("n0 [label=\"capture × 2\\ntest-list\\n1 cached, 1 blocked\", fillcolor=\"#e0e0e0\"]"),
        "{text}"
    );
    assert!(text.contains("n3 [label=\"table × 1\\ntest-list\", fillcolor=\"#ffffff\"]"), "{text}");
    let edges: Vec<&str> = text.lines().filter(|line| line.contains("->")).map(str::trim).collect();
    assert_eq!(edges, ["n0 -> n1;", "n0 -> n2;", "n1 -> n2;", "n2 -> n3;"]);
}

#[test]
fn names_are_quoted() {
    let mut plan = diamond();
    plan.recipe = "a\"b\\".into();
    assert!(dot(&plan, &BTreeMap::new(), false).starts_with("digraph \"a\\\"b\\\\\" {"));
}

#[test]
fn state_names_equal_those_in_json() {
    for state in NodeState::ALL {
        assert_eq!(serde_json::to_value(state).unwrap(), state.name());
    }
}

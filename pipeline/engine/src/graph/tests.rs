use std::collections::BTreeMap;

use super::{NodeState, dot, mermaid};
use crate::plan::tests::diamond;

#[test]
fn dot_draws_every_job_and_edge() {
    let states = BTreeMap::from([(0, NodeState::Cached), (2, NodeState::Failed)]);
    let text = dot(&diamond(), &states, false);
    insta::assert_snapshot!(text, @r##"
    digraph "diamond" {
      rankdir=LR;
      node [shape=box, style="rounded,filled", fontname="sans-serif"];
      n0 [label="capture/ball\ntest-list", fillcolor="#c8e6c9"];
      n1 [label="capture/lego\ntest-list", fillcolor="#ffffff"];
      n2 [label="train/ball/mcgs\ntest-list", fillcolor="#ffcdd2"];
      n3 [label="train/lego/mcgs\ntest-list", fillcolor="#ffffff"];
      n4 [label="render/ball/mcgs\ntest-list", fillcolor="#ffffff"];
      n5 [label="render/lego/mcgs\ntest-list", fillcolor="#ffffff"];
      n6 [label="table\ntest-list", fillcolor="#ffffff"];
      n0 -> n2;
      n0 -> n4;
      n1 -> n3;
      n1 -> n5;
      n2 -> n4;
      n3 -> n5;
      n4 -> n6;
      n5 -> n6;
    }
    "##);
}

#[test]
fn mermaid_draws_every_job_and_edge() {
    let text = mermaid(&diamond(), &BTreeMap::from([(6, NodeState::Planned)]), false);
    insta::assert_snapshot!(text, @r##"
    flowchart LR
      n0["capture/ball<br/>test-list"]:::unknown
      n1["capture/lego<br/>test-list"]:::unknown
      n2["train/ball/mcgs<br/>test-list"]:::unknown
      n3["train/lego/mcgs<br/>test-list"]:::unknown
      n4["render/ball/mcgs<br/>test-list"]:::unknown
      n5["render/lego/mcgs<br/>test-list"]:::unknown
      n6["table<br/>test-list"]:::planned
      n0 --> n2
      n0 --> n4
      n1 --> n3
      n1 --> n5
      n2 --> n4
      n3 --> n5
      n4 --> n6
      n5 --> n6
      classDef unknown fill:#ffffff,stroke:#555,color:#000
      classDef planned fill:#fff9c4,stroke:#555,color:#000
    "##);
}

#[test]
fn collapsed_templates_count_their_jobs_and_show_the_worst_state() {
    let states = BTreeMap::from([(0, NodeState::Cached), (1, NodeState::Blocked), (2, NodeState::Running)]);
    let text = dot(&diamond(), &states, true);
    insta::assert_snapshot!(text, @r##"
    digraph "diamond" {
      rankdir=LR;
      node [shape=box, style="rounded,filled", fontname="sans-serif"];
      n0 [label="capture × 2\ntest-list\n1 cached, 1 blocked", fillcolor="#e0e0e0"];
      n1 [label="train × 2\ntest-list\n1 running", fillcolor="#bbdefb"];
      n2 [label="render × 2\ntest-list", fillcolor="#ffffff"];
      n3 [label="table × 1\ntest-list", fillcolor="#ffffff"];
      n0 -> n1;
      n0 -> n2;
      n1 -> n2;
      n2 -> n3;
    }
    "##);
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

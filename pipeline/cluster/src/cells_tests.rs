//! Cells of a small plan that is written out manually.

use engine::{Measurements, Node, Plan, PlanInput};

use super::*;

/// A plan from lines `name <- producer producer`; `*` before the producers marks a port for many.
pub(crate) fn plan(lines: &str) -> Plan {
    let mut plan = Plan {
        recipe: "test".into(),
        nodes: Vec::new(),
        origins: BTreeMap::new(),
        left_out: Vec::new(),
        device: DeviceClass::Cpu,
        changes: Vec::new(),
    };
    for line in lines.split(';').map(str::trim) {
        let (name, read) = line.split_once("<-").unwrap_or((line, ""));
        let many = read.trim().starts_with('*');
        let producers =
            read.split_whitespace().filter(|word| *word != "*").map(|word| plan.index_of(word).expect(word));
        let input = PlanInput {
            port: "in".into(),
            artifact: ("text".into(), 1),
            many,
            measurements: Measurements::Unread,
            producers: producers.collect(),
        };
        let node =
            Node { name: name.trim().into(), inputs: vec![input], on_device: name.starts_with("train"), ..empty() };
        plan.nodes.push(node);
    }
    plan
}

fn empty() -> Node {
    serde_json::from_value(serde_json::json!({
        "name": "", "template": "", "stage": "", "coordinates": {}, "params": null, "inputs": [], "sources": [],
        "threads": 0, "work": null, "on_device": false, "output": ["text", 1], "unused_sources": {}, "code": {},
        "decisions": [], "plan_id": "",
    }))
    .expect("a node")
}

/// `cell: its jobs <- cells that it reads`, one per cell, and the collecting jobs.
fn describe(plan: &Plan, cells: &Cells) -> String {
    let names = |nodes: &BTreeSet<usize>| {
        nodes.iter().map(|&index| plan.nodes[index].name.as_str()).collect::<Vec<_>>().join(" ")
    };
    let mut lines: Vec<String> = Vec::new();
    for cell in &cells.cells {
        let read: Vec<&str> = cell.producers.iter().map(|&other| cells.cells[other].name.as_str()).collect();
        let line = format!("{} ({:?}): {} <- {}", cell.name, cell.class, names(&cell.nodes), read.join(" "));
        lines.push(line.trim_end().to_owned());
    }
    lines.sort();
    lines.push(format!("collect: {}", names(&cells.collecting)));
    lines.join("\n")
}

fn cells(plan: &Plan, nodes: &BTreeSet<usize>) -> Cells {
    Cells::of(plan, nodes, |node| node.name.starts_with("train"))
}

const PLAN: &str = "capture; prior <- capture; own; train_warm <- capture; train_a <- train_warm prior; \
                    train_b <- train_warm own; train_first <- capture; train_last <- train_first; \
                    render_a <- train_a; render_b <- train_b; metric_a <- render_a capture; \
                    difference <- render_a render_b; report <- * metric_a";

#[test]
fn a_cell_is_a_training_with_what_only_it_feeds_and_needs() {
    let plan = plan(PLAN);
    let cells = cells(&plan, &(0..plan.nodes.len()).collect());
    insta::assert_snapshot!(describe(&plan, &cells), @r"
    capture (Prepare): capture <-
    train_a (Cpu): prior train_a render_a metric_a <- capture train_warm
    train_b (Cpu): own train_b render_b <- train_warm
    train_last (Cpu): train_first train_last <- capture
    train_warm (Cpu): train_warm <- capture
    collect: difference report
    ");
}

#[test]
fn finished_jobs_are_no_part_of_cells() {
    let plan = plan(PLAN);
    let left = ["train_a", "render_a", "metric_a", "report"].map(|name| plan.index_of(name).unwrap());
    let cells = cells(&plan, &left.into());
    insta::assert_snapshot!(describe(&plan, &cells), @r"
    train_a (Cpu): train_a render_a metric_a <-
    collect: report
    ");
}

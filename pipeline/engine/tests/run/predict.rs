//! Predictions of runs.

use std::collections::BTreeSet;
use std::fs;

use engine::DeviceClass;
use engine::event::Outcome;
use engine::scheduler::Sources;
use engine::status::{History, Prediction, State, predict};

use crate::world::{GRID, World, nodes};

pub(crate) const TESTS: &[(&str, fn())] = &[
    ("a_new_plan_will_run_completely", a_new_plan_will_run_completely),
    ("changes_are_named_and_consequences_may_be_cut_off", changes_are_named_and_consequences_may_be_cut_off),
    ("runs_of_another_recipe_are_not_earlier_runs", runs_of_another_recipe_are_not_earlier_runs),
    ("missing_data_and_failures_are_predicted", missing_data_and_failures_are_predicted),
];

/// The prediction for every node, in words, in plan order.
pub(crate) fn predicted(world: &World, overrides: &[&str]) -> Vec<String> {
    let plan = world.plan(overrides);
    let all: BTreeSet<usize> = (0..plan.nodes.len()).collect();
    let store = world.store();
    let sources = Sources::digest(&plan, &all, &world.root.join("data"), &store, false).unwrap();
    let predictions = predict(&plan, &store, &all, &BTreeSet::new(), &sources).unwrap();
    predictions
        .iter()
        .map(|(&index, prediction)| format!("{}: {}", plan.nodes[index].name, words(prediction)))
        .collect()
}

fn words(prediction: &Prediction) -> String {
    let sentences: Vec<&str> = prediction.changes().iter().map(|change| change.sentence.as_str()).collect();
    let sentences = sentences.join(", ");
    match &prediction.state {
        State::Cached { .. } => "cached".into(),
        State::WillRun { last_failure: Some(record), .. } => format!("failed before ({:?})", record.failure.kind),
        State::WillRun { .. } => format!("will run ({sentences})"),
        State::Pending { may_be_cut_off: true, .. } => format!("may be cut off ({sentences})"),
        State::Pending { .. } => format!("will run later ({sentences})"),
        State::MissingData { .. } => "missing data".into(),
        State::Blocked { because_of, .. } => format!("blocked by {because_of}"),
    }
}

fn a_new_plan_will_run_completely() {
    let lines = predicted(&World::new(GRID), &[]);
    let expected = [
        "text/ball: will run (never ran)",
        "text/lego: will run (never ran)",
        "work/ball/p: will run later (never ran)",
        "work/ball/q: will run later (never ran)",
        "work/lego/p: will run later (never ran)",
        "work/lego/q: will run later (never ran)",
        "list: will run later (never ran)",
    ];
    assert_eq!(lines, expected);
}

fn runs_of_another_recipe_are_not_earlier_runs() {
    let world = World::new(GRID);
    world.run(&[]);
    let lines = predicted(&world, &["name = \"other\"", "nodes.work.params.steps=5"]);
    assert!(lines.contains(&"text/ball: cached".into()), "{lines:?}");
    assert!(lines.contains(&"work/lego/p: will run (never ran)".into()), "{lines:?}");
    let (history, node) = (History::read(&world.store()).unwrap(), &world.plan(&[]).nodes[0]);
    let is_there = |recipe: &str, device| history.newest(recipe, node, device).is_some();
    assert!(is_there("grid", None) && is_there("grid", Some(DeviceClass::Cpu)));
    assert!(!is_there("other", None) && !is_there("grid", Some(DeviceClass::Gpu)));
}

fn changes_are_named_and_consequences_may_be_cut_off() {
    let world = World::new(GRID);
    world.run(&["nodes.work.params.keep=4"]);
    assert!(predicted(&world, &["nodes.work.params.keep=4"]).iter().all(|line| line.ends_with(": cached")));
    let change = ["nodes.work.params.keep=4", "nodes.work.params.steps=5"];
    let lines = predicted(&world, &change);
    assert!(lines.contains(&"text/ball: cached".into()), "{lines:?}");
    assert!(lines.contains(&"work/lego/p: will run (params.steps 3 → 5)".into()), "{lines:?}");
    assert!(lines.contains(&"list: may be cut off (reads work/ball/p and 3 more)".into()), "{lines:?}");
    // The four letters that `keep` leaves are the same for any number of steps.
    let summary = world.run(&change);
    assert_eq!(summary.results["list"].outcome, Outcome::Cached);
}

fn missing_data_and_failures_are_predicted() {
    let recipe = GRID.replace("text = \"{scene}:\"", "source = \"{scene}.txt\"");
    let rule = "[[set]]\nwhen = { seed = \"q\" }\nnodes.work.params.fail = \"diverged\"\n";
    let world = World::new(&format!("{recipe}{rule}"));
    fs::write(world.root.join("data/ball.txt"), "ball").unwrap();
    let summary = world.run(&[]);
    assert_eq!(nodes(&summary, Outcome::Failed), ["work/ball/q"]);
    let lines = predicted(&world, &[]);
    assert!(lines.contains(&"text/lego: missing data".into()), "{lines:?}");
    assert!(lines.contains(&"work/lego/p: blocked by text/lego".into()), "{lines:?}");
    assert!(lines.contains(&"work/ball/q: failed before (Diverged)".into()), "{lines:?}");
}

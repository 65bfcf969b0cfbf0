//! Predictions of runs.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use engine::event::Outcome;
use engine::history::History;
use engine::scheduler::{self, Sources};
use engine::status::{Prediction, State, predict};
use engine::store::ActionRecord;
use engine::{DeviceClass, Plan};

use crate::world::{GRID, World, nodes};

pub(crate) const TESTS: &[(&str, fn())] = &[
    ("a_new_plan_will_run_completely", a_new_plan_will_run_completely),
    ("changes_are_named_and_consequences_may_be_cut_off", changes_are_named_and_consequences_may_be_cut_off),
    ("runs_of_another_recipe_are_not_earlier_runs", runs_of_another_recipe_are_not_earlier_runs),
    ("the_last_result_may_have_been_in_the_store", the_last_result_may_have_been_in_the_store),
    ("runs_with_other_options_or_devices_are_not_the_last", runs_with_other_options_or_devices_are_not_the_last),
    ("a_result_that_lost_data_is_not_the_last", a_result_that_lost_data_is_not_the_last),
    ("missing_data_and_failures_are_predicted", missing_data_and_failures_are_predicted),
    ("what_was_found_before_a_run_is_not_looked_up_again", what_was_found_before_a_run_is_not_looked_up_again),
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
}

/// The last result and the earlier result of a job of the plan.
fn results(world: &World, plan: &Plan, job: &str) -> [Option<ActionRecord>; 2] {
    let history = History::read(&world.store(), plan).unwrap();
    let node = &plan.nodes[plan.index_of(job).unwrap()];
    [history.last(node), history.earlier(node)].map(|record| record.cloned())
}

fn the_last_result_may_have_been_in_the_store() {
    let world = World::new(GRID);
    for steps in [3, 4, 3] {
        world.run(&[&format!("nodes.work.params.steps={steps}")]);
    }
    let change = "work/lego/p: will run (params.steps 3 → 5)";
    let lines = predicted(&world, &["nodes.work.params.steps=5"]);
    assert!(lines.contains(&change.into()), "{lines:?}");
    // All results of another recipe were in the store. A process that shared a run wrote its own events, and was killed.
    let other = world.run(&["name = \"other\""]);
    assert_eq!(nodes(&other, Outcome::Cached).len(), 7);
    let dir = world.store().run_dir(&other.run);
    let events = fs::read_to_string(dir.join("events.jsonl")).unwrap();
    fs::write(dir.join("events-worker-1.jsonl"), events + "{\"event\":\"finished\",\"no").unwrap();
    ["events.jsonl", "summary.json"].iter().for_each(|file| fs::remove_file(dir.join(file)).unwrap());
    let lines = predicted(&world, &["name = \"other\"", "nodes.work.params.steps=5"]);
    assert!(lines.contains(&change.into()), "{lines:?}");
    // Without events, only the results that a run of the recipe made are known.
    fs::remove_file(dir.join("events-worker-1.jsonl")).unwrap();
    let lines = predicted(&world, &["name = \"other\"", "nodes.work.params.steps=5"]);
    assert!(lines.contains(&"work/lego/p: will run (never ran)".into()), "{lines:?}");
}

fn runs_with_other_options_or_devices_are_not_the_last() {
    let world = World::new(GRID);
    let plan = |steps: usize, option: &str| {
        let changes = option.split_whitespace().map(str::to_owned).collect();
        Plan { changes, ..world.plan(&[&format!("nodes.work.params.steps={steps}")]) }
    };
    for plan in [plan(3, ""), plan(4, "-s x")] {
        scheduler::run(&plan, &world.store(), &world.options(&plan), &mut |_| ()).unwrap();
    }
    let steps = |plan: &Plan| {
        let of = |record: ActionRecord| record.components.params["steps"].as_u64();
        results(&world, plan, "work/lego/p").map(|record| record.and_then(of))
    };
    assert_eq!(steps(&plan(5, "")), [Some(3), Some(3)]);
    assert_eq!(steps(&plan(5, "-s x")), [Some(4), Some(4)]);
    assert_eq!(steps(&plan(5, "-s y")), [None, Some(3)]);
    assert_eq!(steps(&Plan { device: DeviceClass::Gpu, ..plan(5, "-s x") }), [None, Some(4)]);
    assert_eq!(steps(&Plan { recipe: "other".into(), ..plan(5, "") }), [None, None]);
    let others = |plan: &Plan| -> Vec<String> {
        let history = History::read(&world.store(), plan).unwrap();
        let runs = history.other_runs(&plan.nodes[plan.index_of("work/lego/p").unwrap()]);
        runs.map(|(changes, device)| format!("{}: {}", device.as_str(), changes.join(" "))).collect()
    };
    assert_eq!(others(&plan(5, "-s y")), ["cpu: -s x", "cpu: "]);
    assert_eq!(others(&plan(5, "-s x")), ["cpu: "]);
    assert_eq!(others(&Plan { device: DeviceClass::Gpu, ..plan(5, "") }), ["cpu: -s x", "cpu: "]);
}

fn a_result_that_lost_data_is_not_the_last() {
    let world = World::new(&GRID.replace("text = \"{scene}:\"", "source = \"{scene}.txt\""));
    ["ball", "lego"].iter().for_each(|scene| fs::write(world.root.join(format!("data/{scene}.txt")), scene).unwrap());
    let whole = world.run(&[]).results["list"].content;
    fs::remove_file(world.root.join("data/lego.txt")).unwrap();
    for _ in 0..2 {
        assert_ne!(world.run(&[]).results["list"].content, whole);
        let [last, _] = results(&world, &world.plan(&[]), "list");
        assert_eq!(last.map(|record| record.content), whole);
    }
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

fn what_was_found_before_a_run_is_not_looked_up_again() {
    let world = World::new(GRID);
    world.run(&[]);
    let plan = world.plan(&[]);
    let all: BTreeSet<usize> = (0..plan.nodes.len()).collect();
    let sources = Sources::digest(&plan, &all, &world.root.join("data"), &world.store(), false).unwrap();
    let predictions = predict(&plan, &world.store(), &all, &BTreeSet::new(), &sources).unwrap();
    let found: BTreeMap<_, _> =
        predictions.into_iter().filter_map(|(index, prediction)| Some((index, prediction.cached()?))).collect();
    assert_eq!(found.len(), plan.nodes.len());
    // Without their records, the results can come from `found` only.
    let records = world.root.join("store/records");
    fs::rename(&records, world.root.join("hidden")).unwrap();
    fs::create_dir(&records).unwrap();
    let again = world.run_with(&[], |options| options.found = found.clone(), |_, _| ());
    assert_eq!(again.counts.cached, plan.nodes.len());
    // A result of another key is not that of the job.
    let other = world.run_with(&["nodes.work.params.steps=5"], |options| options.found = found, |_, _| ());
    assert_eq!(nodes(&other, Outcome::Cached), ["text/ball", "text/lego"]);
}

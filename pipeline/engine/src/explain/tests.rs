use std::collections::BTreeMap;

use serde_json::json;

use super::{Change, Component, RootCause, diff, root_causes};
use crate::key::tests::components;
use crate::plan::tests::diamond;
use crate::{FailureKind, KeyComponents, KeyInput};

/// The sentences after `edit`.
fn sentences(edit: impl FnOnce(&mut KeyComponents)) -> Vec<String> {
    let (old, mut new) = (components(), components());
    edit(&mut new);
    diff(&old, &new).into_iter().map(|change| change.sentence).collect()
}

#[test]
fn equal_keys_have_no_difference() {
    assert!(sentences(|_| ()).is_empty());
}

#[test]
fn every_component_has_a_sentence() {
    assert_eq!(sentences(|key| key.stage = "b".into()), ["stage training → b"]);
    assert_eq!(sentences(|key| key.environment = "gpu".into()), ["environment cpu → gpu"]);
    assert_eq!(sentences(|key| key.output.1 = 2), ["output model schema 1 → model schema 2"]);
    assert_eq!(sentences(|key| key.params["rate"] = json!(0.0002)), ["params.rate 0.00016 → 0.0002"]);
    assert_eq!(sentences(|key| key.params["rate"] = json!(f64::from(0.1f32))), ["params.rate 0.00016 → 0.1"]);
    assert_eq!(sentences(|key| key.params["grid"]["levels"] = json!([1, 2])), ["params.grid.levels [1] → [1,2]"]);
    assert_eq!(sentences(|key| key.params["new"] = json!("x")), ["params.new \"x\" added"]);
    let code = |key: &mut KeyComponents| {
        key.code.insert("shaders".into(), "x".into());
        key.code.insert("training dependencies".into(), "x".into());
    };
    assert_eq!(sentences(code), ["code: crate shaders changed", "code: external dependencies of training added"]);
    assert_eq!(
        sentences(|key| drop(key.sources.insert("images".into(), "x".into()))),
        ["the files of `images` changed"]
    );
    assert_eq!(sentences(|key| key.sources.clear()), ["the files of `images` removed"]);
}

#[test]
fn inputs_are_compared_producer_by_producer() {
    let one = |key: &mut KeyComponents| key.inputs.get_mut("capture").unwrap()[0].content = Some("x".into());
    assert_eq!(sentences(one), ["input capture: content changed"]);
    let many = |edit: fn(&mut Vec<KeyInput>)| sentences(|key| edit(key.inputs.get_mut("runs").unwrap()));
    assert_eq!(many(|runs| runs[1].measurements = Some("x".into())), ["input runs (scene=lego): measurements changed"]);
    assert_eq!(many(|runs| drop(runs.remove(0))), ["input runs (scene=ball): removed"]);
    assert_eq!(many(|runs| runs.push(KeyInput::default())), ["input runs: added"]);
    assert_eq!(many(|runs| runs.push(runs[0].clone())), ["input runs (scene=ball again): added"]);
    assert_eq!(many(|runs| runs.swap(0, 1)), ["input runs: order changed"]);
    let failed = |runs: &mut Vec<KeyInput>| {
        runs[0] = KeyInput { content: None, failure: Some(FailureKind::Diverged), ..runs[0].clone() };
    };
    assert_eq!(many(failed), ["input runs (scene=ball): failed (diverged)"]);
}

fn change(component: Component) -> Vec<Change> {
    vec![Change::new(component, format!("{component:?}"))]
}

#[test]
fn root_causes_are_grouped_and_consequences_counted() {
    // Nodes: 0 1 captures, 2 3 trainings, 4 5 renderings, 6 the table.
    let (params, input) = (change(Component::Params), change(Component::Input));
    let both = [input.clone(), change(Component::Environment)].concat();
    let changes = BTreeMap::from([(2, params.clone()), (3, params.clone()), (4, input.clone()), (5, both), (6, input)]);
    let found = root_causes(&diamond(), &changes);
    let expected = [
        RootCause { nodes: vec![2, 3], changes: params, consequences: 2 },
        RootCause { nodes: vec![5], changes: change(Component::Environment), consequences: 1 },
    ];
    assert_eq!(found, expected);
}

#[test]
fn a_changed_input_without_upstream_change_is_a_root_cause() {
    let changes = BTreeMap::from([(4, change(Component::Input)), (2, Vec::new())]);
    let expected = RootCause { nodes: vec![4], changes: change(Component::Input), consequences: 0 };
    assert_eq!(root_causes(&diamond(), &changes), [expected]);
    assert!(root_causes(&diamond(), &BTreeMap::new()).is_empty());
}

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;
use serde_json::{Map, Value, json};

use super::{ActionKey, KeyComponents, KeyInput, plan_id};
use crate::plan::{DeviceClass, Node, Plan, PlanSource};
use crate::registry::tests::registry;
use crate::{Coordinates, Decision, FailureKind, Measurements, canonical};

fn coordinates(pairs: &[(&str, &str)]) -> Coordinates {
    pairs.iter().map(|(axis, value)| (axis.to_string(), value.to_string())).collect()
}

/// The components of a key, none of them empty.
pub(crate) fn components() -> KeyComponents {
    let run = |scene: &str, content: &str| KeyInput {
        coordinates: coordinates(&[("scene", scene)]),
        content: Some(content.into()),
        measurements: Some(format!("m{content}")),
        failure: None,
    };
    let capture = KeyInput { content: Some("c0".into()), ..KeyInput::default() };
    KeyComponents {
        stage: "training".into(),
        code: BTreeMap::from([("shaders".into(), "s0".into()), ("training".into(), "t0".into())]),
        params: json!({ "rate": 0.00016, "steps": 300, "grid": { "levels": [1] } }),
        inputs: BTreeMap::from([
            ("capture".into(), vec![capture]),
            ("runs".into(), vec![run("ball", "r0"), run("lego", "r1")]),
        ]),
        sources: BTreeMap::from([("images".into(), "i0".into())]),
        output: ("model".into(), 1),
        environment: "cpu".into(),
    }
}

type Edit = fn(&mut KeyComponents);

/// One edit of every part of a key.
const EDITS: [(&str, Edit); 22] = [
    ("stage", |key| key.stage += "x"),
    ("code of a crate", |key| drop(key.code.insert("shaders".into(), "s1".into()))),
    ("another crate", |key| drop(key.code.insert("scene".into(), "s0".into()))),
    ("a crate less", |key| drop(key.code.remove("shaders"))),
    ("a parameter", |key| key.params["rate"] = json!(0.0002)),
    ("a nested parameter", |key| key.params["grid"]["levels"] = json!([2])),
    ("a longer array", |key| key.params["grid"]["levels"] = json!([1, 1])),
    ("an integer as float", |key| key.params["steps"] = json!(300.0)),
    ("an integer as text", |key| key.params["steps"] = json!("300")),
    ("a parameter more", |key| key.params["x"] = json!(null)),
    ("a moved parameter", |key| key.params = json!({ "rate": 0.00016, "steps": 300, "levels": [1], "grid": {} })),
    ("a source", |key| drop(key.sources.insert("images".into(), "i1".into()))),
    ("a source's name", |key| key.sources = BTreeMap::from([("masks".into(), "i0".into())])),
    ("output type", |key| key.output.0 = "video".into()),
    ("output schema", |key| key.output.1 = 2),
    ("environment", |key| key.environment = "gpu".into()),
    ("an input's content", |key| key.inputs.get_mut("capture").unwrap()[0].content = Some("c1".into())),
    ("an input's measurements", |key| key.inputs.get_mut("runs").unwrap()[0].measurements = None),
    ("an input's coordinates", |key| {
        key.inputs.get_mut("runs").unwrap()[0].coordinates = coordinates(&[("scene", "x")])
    }),
    ("a failed input", |key| {
        let input = &mut key.inputs.get_mut("runs").unwrap()[0];
        (input.content, input.failure) = (None, Some(FailureKind::Diverged));
    }),
    ("the order of inputs", |key| key.inputs.get_mut("runs").unwrap().swap(0, 1)),
    ("a port's name", |key| {
        let runs = key.inputs.remove("runs").unwrap();
        key.inputs.insert("walks".into(), runs);
    }),
];

#[test]
fn every_edit_of_every_component_changes_the_key() {
    let edited = |edit: Edit| {
        let mut key = components();
        edit(&mut key);
        ActionKey::new(&key)
    };
    let mut keys: BTreeSet<ActionKey> = EDITS.iter().map(|(_, edit)| edited(*edit)).collect();
    assert!(keys.insert(ActionKey::new(&components())));
    assert_eq!(keys.len(), EDITS.len() + 1);
}

#[test]
fn keys_survive_json() {
    let copy: KeyComponents = serde_json::from_str(&serde_json::to_string(&components()).unwrap()).unwrap();
    assert_eq!(copy, components());
    assert_eq!(ActionKey::new(&copy), ActionKey::new(&components()));
}

/// Keys of existing stores. A change here reruns every job and needs a new version in the key's tag.
#[test]
fn golden_keys() {
    let hash = |value: Value| canonical::sha256_hex("golden", &value);
    let golden = [
        (hash(json!(null)), "5909216a63ec1805"),
        (hash(json!([])), "f4643d1ee10ea1c8"),
        (hash(json!({})), "17a1337779eb63b4"),
        (hash(json!([true, false, ""])), "906d0f2082ad6196"),
        (hash(json!([0, -1, i64::MIN, u64::MAX])), "c1cc4c0c0237f753"),
        (hash(json!([0.0, 0.1, -1e300, 5e-324])), "0834776e168e1935"),
        (hash(json!({ "b": [{ "a": "ä" }], "a": 1.0 })), "ad709baa65d35bc0"),
        (ActionKey::new(&components()).to_string(), "6e49e5d0f51f0770"),
        (plan_of(&["train/ball/0"])[0].clone(), "c043147ed9667304"),
        (plan_of(&["list"])[0].clone(), "a6683896ec87770a"),
    ];
    let found: Vec<&str> = golden.iter().map(|(hash, _)| &hash[..16]).collect();
    let expected: Vec<&str> = golden.iter().map(|(_, hash)| *hash).collect();
    assert_eq!(found, expected);
}

#[test]
fn the_canonical_bytes_are_tagged_and_delimited() {
    let bytes = |value: Value| canonical::bytes(&value);
    assert_eq!(bytes(json!(true)), [b'b', 1]);
    assert_eq!(bytes(json!("a")), [b's', 1, 0, 0, 0, 0, 0, 0, 0, b'a']);
    assert_ne!(bytes(json!(["ab", "c"])), bytes(json!(["a", "bc"])));
    assert_ne!(bytes(json!([[1], 2])), bytes(json!([[1, 2]])));
    assert_ne!(bytes(json!(1)), bytes(json!(1.0)));
    assert_ne!(bytes(json!(null)), bytes(json!(false)));
    assert_eq!(bytes(json!(-0.0)), bytes(json!(0.0)));
    assert_eq!(bytes(json!(7u64)), bytes(json!(7i64)));
}

fn any_json() -> impl Strategy<Value = Value> {
    let number = prop_oneof![any::<i64>().prop_map(Value::from), (-1e9..1e9).prop_map(|float: f64| json!(float))];
    let leaf =
        prop_oneof![Just(Value::Null), any::<bool>().prop_map(Value::Bool), number, ".{0,6}".prop_map(Value::String)];
    leaf.prop_recursive(3, 24, 5, |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..5).prop_map(Value::Array),
            prop::collection::btree_map(".{0,4}", inner, 0..5).prop_map(|map| Value::Object(map.into_iter().collect())),
        ]
    })
}

proptest! {
    #[test]
    fn key_order_does_not_change_the_bytes(
        entries in prop::collection::btree_map("[a-e]{1,3}", any_json(), 0..8)
            .prop_flat_map(|map| (Just(map.clone()), Just(map.into_iter().collect::<Vec<_>>()).prop_shuffle())),
    ) {
        let (sorted, shuffled) = entries;
        let sorted = Value::Object(sorted.into_iter().collect());
        let shuffled = Value::Object(shuffled.into_iter().collect::<Map<_, _>>());
        prop_assert_eq!(canonical::bytes(&sorted), canonical::bytes(&shuffled));
    }

    #[test]
    fn unequal_values_have_unequal_bytes(left in any_json(), right in any_json()) {
        prop_assert_eq!(left == right, canonical::bytes(&left) == canonical::bytes(&right));
    }

    #[test]
    fn json_text_does_not_change_the_bytes(value in any_json()) {
        let copy: Value = serde_json::from_str(&value.to_string()).unwrap();
        prop_assert_eq!(canonical::bytes(&copy), canonical::bytes(&value));
    }
}

const RECIPE: &str = r#"
[axes]
scene = ["ball", "lego"]
seed = [0]
[nodes.write]
stage = "test-write"
over = ["scene"]
params = { text = "x", source = "in" }
[nodes.train]
stage = "test-work"
over = ["scene", "seed"]
inputs.text = "write"
params = { rate = 1e-3 }
[nodes.list]
stage = "test-list"
inputs.texts = ["train"]
"#;

fn plan(recipe: &str) -> Plan {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("recipe.toml");
    std::fs::write(&path, recipe).unwrap();
    crate::recipe::resolve(&path, &[], &registry(), folder.path()).unwrap_or_else(|errors| panic!("{errors}"))
}

fn ids(plan: &Plan, names: &[&str]) -> Vec<String> {
    names.iter().map(|name| plan.nodes[plan.index_of(name).unwrap()].plan_id.clone()).collect()
}

fn plan_of(names: &[&str]) -> Vec<String> {
    ids(&plan(RECIPE), names)
}

#[test]
fn spelling_layout_and_names_do_not_change_plan_ids() {
    let edits = [
        ("1e-3", "0.001"),
        ("{ rate = 1e-3 }", "{ steps = 1, rate = 1e-3 }"),
        (
            "inputs.text = \"write\"\nparams = { rate = 1e-3 }",
            "params.rate = 0.001 # note\ninputs = { text = \"write\" }",
        ),
        ("[axes]", "name = \"other\"\n[axes]"),
        ("nodes.train]", "nodes.training]"),
    ];
    for (from, to) in edits {
        assert!(RECIPE.contains(from));
        let edited = plan(
            &RECIPE
                .replace(from, to)
                .replace("[\"train\"]", if to.contains("training]") { "[\"training\"]" } else { "[\"train\"]" }),
        );
        let all = |plan: &Plan| plan.nodes.iter().map(|node| node.plan_id.clone()).collect::<Vec<_>>();
        assert_eq!(all(&edited), all(&plan(RECIPE)), "{from} → {to}");
    }
}

#[test]
fn a_renamed_axis_value_changes_only_jobs_that_see_it() {
    let renamed = plan(&RECIPE.replace("\"ball\"", "\"sphere\""));
    assert_eq!(ids(&renamed, &["write/sphere", "train/sphere/0"]), plan_of(&["write/ball", "train/ball/0"]));
    assert_ne!(ids(&renamed, &["list"]), plan_of(&["list"]));
}

#[test]
fn a_changed_value_changes_all_downstream_plan_ids() {
    let rule = "[[set]]\nwhen.scene = \"ball\"\nnodes.write.params.text = \"y\"\n";
    let edited = plan(&format!("{RECIPE}{rule}"));
    let names = ["write/ball", "write/lego", "train/ball/0", "train/lego/0", "list"];
    let changed: Vec<bool> = ids(&edited, &names).iter().zip(plan_of(&names)).map(|(new, old)| *new != old).collect();
    assert_eq!(changed, [true, false, true, false, true]);
}

#[test]
fn plan_ids_depend_on_everything_that_influences_results() {
    let plan = plan(RECIPE);
    let node = &plan.nodes[plan.index_of("list").unwrap()];
    let edits: [fn(&mut Node); 9] = [
        |node| node.stage += "x",
        |node| node.params["title"] = json!("x"),
        |node| drop(node.code.insert("x".into(), "y".into())),
        |node| node.output.1 += 1,
        |node| node.inputs[0].port += "x",
        |node| node.inputs[0].artifact.1 += 1,
        |node| node.inputs[0].measurements = Measurements::Read,
        |node| node.inputs[0].producers.reverse(),
        |node| node.sources.push(PlanSource { name: "a".into(), path: "b".into(), optional: false }),
    ];
    let mut ids = BTreeSet::from([node.plan_id.clone()]);
    for edit in edits {
        let mut edited = node.clone();
        edit(&mut edited);
        ids.insert(plan_id(&edited, &plan.nodes));
    }
    assert_eq!(ids.len(), 10);
    let free: [fn(&mut Node); 6] = [
        |node| node.name += "x",
        |node| node.template += "x",
        |node| node.threads += 1,
        |node| drop(node.coordinates.insert("a".into(), "b".into())),
        |node| node.inputs[0].measurements = Measurements::Relayed,
        |node| node.decisions.push(Decision { effect: "a".into(), on: true, reason: "b".into() }),
    ];
    for edit in free {
        let mut edited = node.clone();
        edit(&mut edited);
        assert_eq!(plan_id(&edited, &plan.nodes), node.plan_id);
    }
}

#[test]
fn keys_leave_out_values_that_the_stage_does_not_see() {
    let plan = plan(RECIPE);
    let input = KeyInput {
        coordinates: coordinates(&[("scene", "ball")]),
        content: Some("c".into()),
        measurements: Some("m".into()),
        failure: None,
    };
    let key = |name: &str, port: &str| {
        let node = &plan.nodes[plan.index_of(name).unwrap()];
        KeyComponents::of(node, BTreeMap::from([(port.into(), vec![input.clone()])]), BTreeMap::new(), DeviceClass::Cpu)
    };
    let one = key("train/ball/0", "text");
    assert_eq!(one.inputs["text"], [KeyInput { content: Some("c".into()), ..KeyInput::default() }]);
    let mut relaying = plan.nodes[plan.index_of("train/ball/0").unwrap()].clone();
    relaying.inputs[0].measurements = Measurements::Relayed;
    let inputs = BTreeMap::from([("text".into(), vec![input.clone()])]);
    assert_eq!(KeyComponents::of(&relaying, inputs, BTreeMap::new(), DeviceClass::Cpu), one);
    let many = key("list", "texts");
    assert_eq!(many.inputs["texts"], [KeyInput { measurements: None, ..input.clone() }]);
    assert_eq!((one.stage.as_str(), one.params["rate"].as_f64()), ("test-work", Some(0.001)));
}

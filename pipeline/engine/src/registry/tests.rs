use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::{AnyStage, Registry};
use crate::test_stages::{Join, List, Text, Work, Write};
use crate::{CodeTable, CrateCode, JobContext, ParamProblem, Port, Stage};

/// The code of the test stages, invented so that keys in tests do not change with the sources.
pub(crate) const CODE: CodeTable = CodeTable {
    crates: &[
        crate_code("test-join", &[("src/lib.rs", "f0")]),
        crate_code("test-list", &[("src/lib.rs", "f1")]),
        crate_code("test-nested", &[("src/lib.rs", "f2")]),
        crate_code("test-work", &[("src/lib.rs", "f3"), ("src/methods/mcgs/mod.rs", "f4")]),
        crate_code("test-write", &[("src/lib.rs", "f5")]),
    ],
};

const fn crate_code(name: &'static str, files: &'static [(&'static str, &'static str)]) -> CrateCode {
    CrateCode { name, files, dependencies: &[], reads_artifacts_of: &[], external: "e0" }
}

/// Built-in recipes: one that extends another by the name of its file.
const RECIPES: crate::Builtins = &[
    ("base", "name = \"base\"\n[nodes.one]\nstage = \"test-write\"\nparams.text = \"base\"\n"),
    ("built", "extends = [\"builtin:base\"]\n"),
];

/// The test stages.
pub(crate) fn registry() -> Registry {
    Registry::new(CODE).with_recipes(RECIPES).with::<Write>().with::<Work>().with::<Join>().with::<List>()
}

fn canonical(stage: &str, raw: Value) -> Result<Value, Vec<(String, String)>> {
    let registry = registry().with::<Nested>();
    let pairs = |problems: Vec<ParamProblem>| problems.into_iter().map(|p| (p.key, p.message)).collect();
    registry.get(stage).unwrap().canonical_params(&raw).map_err(pairs)
}

/// A stage with nested tables, enums, arrays, maps and optional values as parameters.
struct Nested;

#[derive(Clone, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct NestedParams {
    rates: Rates,
    shape: Shape,
    steps: Vec<u32>,
    by_name: BTreeMap<String, Rates>,
    maybe: Option<Rates>,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Rates {
    start: f64,
    end: f64,
}

impl Default for Rates {
    fn default() -> Self {
        Self { start: 1e-3, end: 1e-5 }
    }
}

#[derive(Clone, Copy, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Shape {
    #[default]
    Round,
    RatherSquare,
}

impl Stage for Nested {
    type Params = NestedParams;
    type Output = Text;
    const ID: &'static str = "test-nested";
    const ABOUT: &'static str = "has nested parameters";

    fn ports() -> Vec<Port> {
        Vec::new()
    }

    fn check_params(params: &NestedParams) -> Vec<ParamProblem> {
        let problem = ParamProblem { key: "rates.start".into(), message: "must be above rates.end".into(), hint: None };
        if params.rates.start > params.rates.end { Vec::new() } else { vec![problem] }
    }

    fn run(context: &JobContext, params: &NestedParams) -> anyhow::Result<Text> {
        // In both cases the returned value differs from the written one.
        match params.shape {
            Shape::Round => Text::write(context.output_dir(), "invalid").map(|_| Text("fine".into())),
            Shape::RatherSquare => Text::write(context.output_dir(), "fine").map(|_| Text("invalid".into())),
        }
    }
}

#[test]
fn spelling_does_not_change_canonical_parameters() {
    let plain = canonical("test-nested", json!({})).unwrap();
    let spelled = json!({ "shape": "round", "rates": { "end": 0.00001, "start": 1e-3 }, "steps": [] });
    assert_eq!(canonical("test-nested", spelled).unwrap(), plain);
    assert_eq!(plain["rates"], json!({ "start": 0.001, "end": 0.00001 }));
    let whole = canonical("test-nested", json!({ "rates": { "start": 1 } })).unwrap();
    assert_eq!(whole, canonical("test-nested", json!({ "rates": { "start": 1.0 } })).unwrap());
    assert_ne!(whole, plain);
}

#[test]
fn all_problems_of_nested_parameters_come_at_once() {
    let raw = json!({
        "rates": { "strat": 1, "end": "x" }, "shape": "squaer", "steps": [1, -2], "by_name": { "a": { "x": 1 } },
        "maybe": { "start": true }, "more": 1,
    });
    let mut keys: Vec<String> = canonical("test-nested", raw).unwrap_err().into_iter().map(|(key, _)| key).collect();
    keys.sort();
    assert_eq!(keys, ["by_name.a.x", "maybe.start", "more", "rates.end", "rates.strat", "shape", "steps.1"]);
}

#[test]
fn problems_suggest_the_nearest_allowed_word() {
    let registry = registry().with::<Nested>();
    let problems = |raw: Value| registry.get("test-nested").unwrap().canonical_params(&raw).unwrap_err();
    let shape = &problems(json!({ "shape": "ruond" }))[0];
    assert_eq!(shape.message, "unknown value `ruond`");
    assert_eq!(shape.hint.as_deref(), Some("did you mean `round`? allowed: round, rather-square"));
    let capital = &problems(json!({ "shape": "ROUND" }))[0];
    assert_eq!(capital.hint, shape.hint);
    let own = &problems(json!({ "rates": { "start": 0 } }))[0];
    assert_eq!((own.key.as_str(), own.message.as_str()), ("rates.start", "must be above rates.end"));
}

/// Parameters with a hand-written `Deserialize`, which loses the path of every error.
#[derive(Serialize)]
#[serde(transparent)]
struct ByHand(NestedParams);

impl<'de> Deserialize<'de> for ByHand {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = Value::deserialize(deserializer)?;
        let named = |error: serde_json::Error| serde::de::Error::custom(format!("{error} in the table nested"));
        serde_json::from_value(value).map(Self).map_err(named)
    }
}

#[test]
fn problems_of_a_hand_written_deserialize_have_keys() {
    let raw = json!({
        "rates": { "strat": 1, "end": "x", "start": 1.0 }, "shape": "squaer", "steps": [1, -2], "maybe": { "start": true },
        "by_name": 3,
    });
    let problems = super::params::deserialize_all::<ByHand>(raw).1;
    let message = "invalid type: integer `3`, expected a table in the table nested";
    assert!(problems.iter().any(|problem| (&*problem.key, &*problem.message) == ("by_name", message)), "{problems:?}");
    let mut keys: Vec<String> = problems.into_iter().map(|problem| problem.key).collect();
    keys.sort();
    assert_eq!(keys, ["by_name", "maybe.start", "rates.end", "rates.strat", "shape", "steps"]);
    // A problem with the whole value has no key.
    assert_eq!(super::params::deserialize_all::<ByHand>(json!(3)).1[0].key, "");
}

#[test]
fn parameters_without_a_table_are_one_problem() {
    let problem = "invalid type: integer `3`, expected a table".to_owned();
    assert_eq!(canonical("test-nested", json!(3)).unwrap_err(), [(String::new(), problem)]);
}

#[test]
fn an_infinite_parameter_is_refused() {
    #[derive(Default, Serialize, Deserialize)]
    struct Infinite {
        range: f64,
    }
    assert!(super::params::written_back(&Infinite { range: 1.0 }).is_ok());
    assert!(super::params::written_back(&Infinite { range: f64::INFINITY }).is_err());
    assert!(super::params::written_back(&Infinite { range: f64::NAN }).is_err());
}

#[test]
fn a_stage_with_an_invalid_artifact_fails() {
    let run = |shape: &str| {
        let folder = tempfile::TempDir::new().unwrap();
        let context = JobContext::detached(folder.path()).unwrap();
        let registry = registry().with::<Nested>();
        let stage: &dyn AnyStage = registry.get("test-nested").unwrap();
        format!("{:#}", stage.run(&context, &json!({ "shape": shape })).unwrap_err())
    };
    assert_eq!(run("rather-square"), "test-nested returned a text that is not valid: the text contains `invalid`");
    let read_back = "the text that test-nested wrote is not valid when read back: the text contains `invalid`";
    assert_eq!(run("round"), read_back);
}

#[test]
#[should_panic(expected = "two stages are called test-write")]
fn two_stages_of_one_name_are_refused() {
    let _ = registry().with::<Write>();
}

#[test]
#[should_panic(expected = "no crate in the code table")]
fn a_stage_without_code_is_refused() {
    let _ = Registry::new(CodeTable { crates: &[] }).with::<Write>();
}

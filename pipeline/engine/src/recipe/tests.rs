use std::path::{Path, PathBuf};

use serde_json::json;
use tempfile::TempDir;

use super::{Overrides, RecipeErrors, StageOverride, axis_values, resolve, resolve_with};
use crate::plan::{Origin, Plan};
use crate::registry::tests::registry;

/// A temporary folder of recipes.
struct Recipes(TempDir);

impl Recipes {
    fn new(files: &[(&str, &str)]) -> Self {
        let folder = TempDir::new().unwrap();
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        Self(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn resolve(&self, name: &str, overrides: &[&str]) -> Result<Plan, RecipeErrors> {
        let overrides: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
        resolve(&self.path(name), &overrides, &registry(), self.0.path())
    }
}

pub(crate) fn plan(text: &str, overrides: &[&str]) -> Plan {
    Recipes::new(&[("recipe.toml", text)]).resolve("recipe.toml", overrides).unwrap_or_else(|errors| panic!("{errors}"))
}

/// The errors of a recipe, each as "LINE: KEY: MESSAGE (HINT)".
pub(crate) fn errors(text: &str, overrides: &[&str]) -> Vec<String> {
    let errors = Recipes::new(&[("recipe.toml", text)]).resolve("recipe.toml", overrides).expect_err("must fail");
    let hint = |hint: &Option<String>| hint.as_ref().map(|hint| format!(" ({hint})")).unwrap_or_default();
    errors.0.iter().map(|e| format!("{}: {}: {}{}", e.line, e.key, e.message, hint(&e.hint))).collect()
}

const GRID: &str = r#"
[axes]
scene = ["ball", "lego"]
method = ["a", "b"]
seed = [0, 1]

[nodes.table]
stage = "test-list"
inputs = { texts = ["train", "capture"] }

[nodes.capture]
stage = "test-write"
over = ["scene"]
params = { text = "{scene}: {{scene}} {:03}", source = "in/{scene}" }

[nodes.train]
stage = "test-work"
over = ["seed", "scene", "method"]
inputs = { text = "capture" }
params = { letter = "{method}", steps = 3, rate = 1 }

[[set]]
when = { scene = "ball", method = ["b"] }
nodes.train.params.steps = 5

[[set]]
when = { seed = 1 }
nodes.train.params.keep = 7
"#;

#[test]
fn a_recipe_becomes_jobs_in_topological_order() {
    let plan = plan(GRID, &[]);
    let names: Vec<&str> = plan.nodes.iter().map(|node| node.name.as_str()).collect();
    let expected = [
        "capture/ball",
        "capture/lego",
        "train/ball/a/0",
        "train/ball/a/1",
        "train/ball/b/0",
        "train/ball/b/1",
        "train/lego/a/0",
        "train/lego/a/1",
        "train/lego/b/0",
        "train/lego/b/1",
        "table",
    ];
    assert_eq!(names, expected);
    assert_eq!(plan.recipe, "recipe");
    let train = &plan.nodes[5];
    assert_eq!(
        train.coordinates,
        [("method", "b"), ("scene", "ball"), ("seed", "1")].map(|(k, v)| (k.into(), v.into())).into()
    );
    assert_eq!(train.params["steps"], json!(5));
    assert_eq!(train.params["keep"], json!(7));
    assert_eq!(train.params["rate"], json!(1.0));
    assert_eq!(train.inputs[0].producers, [0]);
    assert_eq!(plan.nodes[8].params["steps"], json!(3));
    assert_eq!(plan.nodes[10].inputs[0].producers, [2, 3, 4, 5, 6, 7, 8, 9, 0, 1]);
    assert_eq!(plan.nodes[0].params["text"], json!("ball: {scene} {:03}"));
    assert_eq!(plan.nodes[1].sources[0].path, Path::new("in/lego"));
}

#[test]
fn a_placeholder_alone_keeps_the_type_of_the_value() {
    let text = GRID.replace("steps = 3", r#"steps = "{seed}""#);
    let plan = plan(&text, &["axes.seed=[4, 6]"]);
    assert_eq!(plan.nodes[2].params["steps"], json!(4));
    assert_eq!(plan.nodes[3].params["steps"], json!(6));
}

#[test]
fn numbers_are_axis_values_with_one_name_each() {
    let text = GRID
        .replace("rate = 1 }", r#"rate = "{scale}" }"#)
        .replace("over = [\"seed\",", "over = [\"scale\", \"seed\",");
    let text = text.replace("seed = [0, 1]", "seed = [0, 1]\nscale = [0.5, 1.0, 2, 1e-7]");
    let rule = "[[set]]\nwhen = { scale = [5e-1, 1] }\nnodes.train.params.keep = 3\n";
    let plan = plan(&(text.clone() + rule), &["axes.scene=[\"ball\"]", "axes.method=[\"a\"]", "axes.seed=[0]"]);
    let trained = plan.nodes.iter().filter(|node| node.stage == "test-work");
    let found: Vec<_> = trained.map(|node| (node.name.as_str(), &node.params["rate"], &node.params["keep"])).collect();
    let all = usize::MAX >> 12;
    let expected = [("0.5", 0.5, 3), ("1", 1.0, 3), ("2", 2.0, all), ("1e-7", 1e-7, all)];
    for ((name, rate, keep), (text, value, kept)) in found.iter().zip(expected) {
        assert_eq!((*name, *rate, *keep), (format!("train/ball/a/0/{text}").as_str(), &json!(value), &json!(kept)));
    }
    assert_eq!(found.len(), 4);
    let twice = errors(&text, &["axes.scale = [1, 1.0]", "nodes.train.params.steps=\"{scale}\""]);
    assert_eq!(twice[0], "1: axes.scale: axis value `1` occurs twice");
}

#[test]
fn plans_survive_json() {
    let plan = plan(GRID, &[]);
    let copy: Plan = serde_json::from_str(&serde_json::to_string(&plan).unwrap()).unwrap();
    assert_eq!(copy, plan);
}

#[test]
fn overrides_win_and_every_value_has_its_origin() {
    let plan = plan(GRID, &["nodes.train.params.keep=9", "axes.scene=[\"ball\"]", r#"name = "mine""#]);
    assert_eq!((plan.recipe.as_str(), plan.nodes.len()), ("mine", 6));
    let origins = |node: &str, key: &str| plan.origins[node][key].clone();
    assert_eq!(plan.nodes[1].params["keep"], json!(9));
    assert_eq!(origins("train/ball/a/1", "keep"), Origin::CommandLine);
    assert_eq!(origins("train/ball/a/1", "sleep_millis"), Origin::Default);
    assert!(matches!(origins("train/ball/a/1", "steps"), Origin::File { line: 20, .. }));
    assert!(matches!(origins("train/ball/b/0", "steps"), Origin::Set { number: 1, line: 24, .. }));
}

#[test]
fn bases_merge_and_rules_accumulate() {
    let base = r#"
name = "base"
[axes]
scene = ["ball", "lego"]
[nodes.capture]
stage = "test-write"
over = ["scene"]
params.text = "base"
[[set]]
when.scene = "lego"
nodes.capture.params.text = "brick"
[[set]]
when.scene = "ball"
nodes.capture.params.source = "in/ball"
"#;
    let main = r#"
extends = ["base.toml"]
[axes]
scene = ["ball", "hook"]
[[set]]
when.scene = "ball"
nodes.capture.params.text = "round"
"#;
    let recipes = Recipes::new(&[("base.toml", base), ("main.toml", main)]);
    let plan = recipes.resolve("main.toml", &[]).unwrap_or_else(|errors| panic!("{errors}"));
    assert_eq!(plan.recipe, "main");
    assert_eq!(plan.nodes.iter().map(|node| &node.name).collect::<Vec<_>>(), ["capture/ball", "capture/hook"]);
    assert_eq!(plan.nodes[0].params, json!({ "text": "round", "source": "in/ball" }));
    assert_eq!(plan.nodes[1].params, json!({ "text": "base", "source": null }));
    let origin = &plan.origins["capture/ball"];
    assert_eq!(origin["text"], Origin::Set { number: 3, file: recipes.path("main.toml"), line: 7 });
    assert_eq!(origin["source"], Origin::Set { number: 2, file: recipes.path("base.toml"), line: 14 });
}

#[test]
fn another_stage_drops_what_bases_state_about_parameters() {
    let base = r#"
[axes]
scene = ["ball"]
[nodes.a]
stage = "test-write"
over = ["scene"]
params.text = "base"
[nodes.capture]
stage = "test-write"
over = ["scene"]
params = { text = "base", source = "in/{scene}" }
[[set]]
when.scene = "ball"
nodes.a.params.text = "ruled"
nodes.capture.params.text = "ruled"
"#;
    let main = "extends = [\"base.toml\"]\n[nodes.capture]\nstage = \"test-work\"\ninputs.text = \"a\"\nparams.steps = 4\n[[set]]\nnodes.capture.params.keep = 2\n";
    let recipes = Recipes::new(&[("base.toml", base), ("main.toml", main)]);
    let plan = recipes.resolve("main.toml", &[]).unwrap_or_else(|errors| panic!("{errors}"));
    let params = |node: &str, key: &str| plan.nodes[plan.index_of(node).unwrap()].params[key].clone();
    assert_eq!(params("a/ball", "text"), json!("ruled"));
    assert_eq!((params("capture/ball", "steps"), params("capture/ball", "keep")), (json!(4), json!(2)));
    // An option replaces a stage, too; the stage of the base keeps the parameters.
    let overrides =
        ["nodes.capture.stage=\"test-work\"", "nodes.capture.inputs.text=\"a\"", "nodes.capture.params.keep=3"];
    let plan = recipes.resolve("base.toml", &overrides).unwrap_or_else(|errors| panic!("{errors}"));
    assert_eq!(plan.nodes[plan.index_of("capture/ball").unwrap()].params["keep"], json!(3));
    let same = recipes.resolve("base.toml", &["nodes.capture.stage=\"test-write\""]).unwrap();
    assert_eq!(same.nodes[same.index_of("capture/ball").unwrap()].params["text"], json!("ruled"));
}

#[test]
fn errors_of_a_base_name_its_file() {
    let recipes = Recipes::new(&[
        ("base.toml", "[nodes.capture]\nstage = \"test-write\"\nparams.txt = \"x\"\n"),
        ("main.toml", "extends = [\"base.toml\"]\nnodse = 1\n"),
    ]);
    let errors = recipes.resolve("main.toml", &[]).unwrap_err();
    let found: Vec<_> = errors.0.iter().map(|error| (error.file.clone(), error.line, error.column)).collect();
    assert_eq!(found, [(recipes.path("main.toml"), 2, 1), (recipes.path("base.toml"), 3, 8)]);
}

#[test]
fn recipes_that_extend_each_other_are_refused() {
    let recipes = Recipes::new(&[("a.toml", "extends = [\"b.toml\"]"), ("b.toml", "extends = [\"a.toml\"]")]);
    let errors = recipes.resolve("a.toml", &[]).unwrap_err();
    assert_eq!(errors.0.len(), 1);
    assert!(errors.0[0].message.starts_with("recipes extend each other: "), "{errors}");
    assert!(errors.0[0].message.ends_with("a.toml"), "{errors}");
    let missing = Recipes::new(&[("a.toml", "extends = [\"nowhere.toml\"]")]).resolve("a.toml", &[]).unwrap_err();
    let found = (missing.0[0].message.starts_with("no such recipe: "), missing.0[0].line, missing.0[0].key.as_str());
    assert_eq!(found, (true, 1, "extends"), "{missing}");
}

#[test]
fn a_missing_recipe_has_no_line_and_the_nearest_name() {
    let recipes = Recipes::new(&[("tiny.toml", ""), ("other.toml", "")]);
    let missing = |name: &str| {
        let text = recipes.resolve(name, &[]).unwrap_err().to_string();
        text.replace(&recipes.0.path().display().to_string(), "DIR")
    };
    let all = ["tinny.toml", "tiny", "bulit.toml", "elsewhere/x.toml"].map(missing).join("\n\n");
    insta::assert_snapshot!(all, @r"
    error: no such recipe: DIR/tinny.toml
      hint: did you mean DIR/tiny.toml?

    error: no such recipe: DIR/tiny
      hint: did you mean DIR/tiny.toml?

    error: no such recipe: DIR/bulit.toml
      hint: did you mean builtin:built?

    error: no such recipe: DIR/elsewhere/x.toml
    ");
    let builtin = |name: &str| resolve(Path::new(name), &[], &registry(), Path::new(".")).unwrap_err().to_string();
    insta::assert_snapshot!([builtin("builtin:bult"), builtin("builtin:x")].join("\n\n"), @r"
    error: no such recipe: builtin:bult
      hint: did you mean builtin:built?

    error: no such recipe: builtin:x
      hint: built-in recipes: base, built
    ");
}

#[test]
fn built_in_recipes_run_and_can_be_extended() {
    let recipes =
        Recipes::new(&[("mine.toml", "extends = [\"builtin:built\"]\n[nodes.one.params]\ntext = \"mine\"\n")]);
    let plan = recipes.resolve("mine.toml", &[]).unwrap_or_else(|errors| panic!("{errors}"));
    assert_eq!((plan.recipe.as_str(), &plan.nodes[0].params["text"]), ("mine", &json!("mine")));
    let plan = resolve(Path::new("builtin:built"), &[], &registry(), Path::new(".")).unwrap();
    assert_eq!((plan.recipe.as_str(), &plan.nodes[0].params["text"]), ("built", &json!("base")));
    let origin = &plan.origins["one"]["text"];
    assert_eq!(*origin, Origin::File { file: "builtin:base".into(), line: 4 });
}

#[test]
fn all_errors_come_at_once() {
    let text = r#"
[axes]
scene = ["ball", "ball", true, "a/b"]
[nodes.capture]
stage = "test-wirte"
ovre = ["scene"]
[nodes.other]
stage = "test-write"
over = ["scen"]
params = { text = "{sene}", sorce = "x" }
[nodes.train]
stage = "test-work"
inputs = { txt = "capture", text = "captures" }
params = { stpes = 3, keep = "x", steps = 0, rate = inf }
[[set]]
when = { scene = "bal", sene = "x" }
nodes.trian.params.steps = 1
"#;
    let expected = [
        "3: axes.scene: axis value `ball` occurs twice",
        "3: axes.scene: axis values are strings or numbers",
        "3: axes.scene: `a/b` cannot be part of a job's name (use letters, digits, `_`, `-`, `+` and `.`, without a leading `.`)",
        "5: nodes.capture.stage: unknown stage `test-wirte` (did you mean `test-write`? allowed: test-join, test-list, test-work, test-write)",
        "6: nodes.capture.ovre: unknown key `ovre` (did you mean `over`? allowed: stage, over, only, only_with, inputs, like, params)",
        "9: nodes.other.over: unknown axis `scen` (did you mean `scene`? allowed: scene)",
        "10: nodes.other.params.text: unknown axis `sene` (did you mean `scene`? allowed: scene; for a literal brace write {{sene}})",
        "10: nodes.other.params.sorce: unknown key `sorce` (did you mean `source`? allowed: text, source)",
        "13: nodes.train.inputs.txt: stage `test-work` has no port `txt` (did you mean `text`? allowed: text)",
        "13: nodes.train.inputs.text: unknown node `captures` (did you mean `capture`? allowed: capture, other, train)",
        "14: nodes.train.params.stpes: unknown key `stpes` (did you mean `steps`? allowed: letter, steps, sleep_millis, rate, keep, fail)",
        "14: nodes.train.params.keep: invalid type: string \"x\", expected a non-negative whole number",
        "14: nodes.train.params.steps: must be at least 1",
        "14: nodes.train.params.rate: numbers must be finite",
        "16: set.when.scene: axis `scene` has no value `bal` (did you mean `ball`? allowed: a/b, ball)",
        "16: set.when.sene: unknown axis `sene` (did you mean `scene`? allowed: scene)",
        "17: set.nodes.trian: unknown node `trian` (did you mean `train`? allowed: capture, other, train)",
    ];
    let found = errors(text, &[]);
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!(found, expected);
    }
    assert_eq!(found.len(), expected.len(), "{found:#?}");
}

#[test]
fn wires_that_do_not_fit_are_refused() {
    let text = r#"
[axes]
seed = [0, 1]
[nodes.capture]
stage = "test-write"
over = ["seed"]
[nodes.one]
stage = "test-work"
inputs = { text = ["capture", "capture"] }
[nodes.two]
stage = "test-work"
inputs.text = "capture"
[nodes.three]
stage = "test-work"
"#;
    let expected = [
        "9: nodes.one.inputs.text: port `text` takes one producer, not 2",
        "9: nodes.one.inputs.text: port `text` takes one producer, but there is one `capture` for each seed (add seed to nodes.one.over)",
        "9: nodes.one.inputs.text: node `capture` occurs twice",
        "9: nodes.one.inputs.text: port `text` takes one producer, but there is one `capture` for each seed (add seed to nodes.one.over)",
        "12: nodes.two.inputs.text: port `text` takes one producer, but there is one `capture` for each seed (add seed to nodes.two.over)",
        "13: nodes.three.inputs.text: stage `test-work` needs an input on port `text` (nodes that produce a text: capture, one, two, three)",
    ];
    assert_eq!(errors(text, &[]), expected);
}

#[test]
fn cycles_are_printed_as_a_path() {
    let node = |name: &str, from: &str| format!("[nodes.{name}]\nstage = \"test-work\"\ninputs.text = \"{from}\"\n");
    let text = [node("start", "a"), node("a", "c"), node("b", "a"), node("c", "b")].concat();
    assert_eq!(errors(&text, &[]), ["6: nodes.a.inputs: nodes depend on each other: a → b → c → a"]);
    // The wire that a recipe adds closes the cycle, not those of its base.
    let base = [node("a", "b"), node("b", "c"), "[nodes.c]\nstage = \"test-write\"\n".into()].concat();
    let main = ["extends = [\"base.toml\"]\n", &node("c", "a")].concat();
    let recipes = Recipes::new(&[("base.toml", &base), ("main.toml", &main)]);
    let errors = recipes.resolve("main.toml", &[]).unwrap_err();
    let places: Vec<_> = errors.0.iter().map(|error| (error.file.clone(), error.line, error.key.as_str())).collect();
    assert_eq!(places, [(recipes.path("main.toml"), 4, "nodes.c.inputs")]);
}

#[test]
fn overrides_without_effect_are_refused() {
    let found = errors(GRID, &["", "extends=[\"x.toml\"]", "set=[]", "sweep.trials=5", "# nothing"]);
    insta::assert_snapshot!(found.join("\n"), @r"
    1: : this override is empty (write key.path=VALUE)
    1: extends: `extends` cannot be overridden (override the values themselves, or write a recipe that extends this one)
    1: set: `set` cannot be overridden (override the values themselves, or write a recipe that extends this one)
    1: sweep: `sweep` cannot be overridden (a search has options of its own, e.g. --sweep, --trials and --limit of `pipeline run`)
    1: : this override is empty (write key.path=VALUE)
    ");
}

#[test]
fn overrides_are_checked_like_files() {
    let found = errors(GRID, &["nodes.train.params.stesp=1", "nodes.trian.params.steps=1", "name=mine", "nodse.x=1"]);
    let expected = [
        "1: nodes.train.params.stesp: unknown key `stesp` (did you mean `steps`? allowed: letter, steps, sleep_millis, rate, keep, fail)",
        "1: set.nodes.trian: unknown node `trian` (did you mean `train`? allowed: table, capture, train)",
        "1: : this override is not a TOML assignment (write key.path=VALUE; strings need quotes, e.g. -s 'name=\"x\"')",
        "1: nodse: unknown key `nodse` (did you mean `nodes`? allowed: name, axes, nodes)",
    ];
    assert_eq!(found, expected);
}

#[test]
fn a_parameter_without_its_node_is_suggested_its_place() {
    let found = errors(GRID, &["steps=1", "keep.x=1", "nodes.train.rate=1", "nodes.capture.txt=\"a\"", "stesp=1"]);
    insta::assert_snapshot!(found.join("\n"), @r"
    1: steps: unknown key `steps` (did you mean `nodes.train.params.steps`?)
    1: keep: unknown key `keep` (did you mean `nodes.train.params.keep`?)
    1: nodes.train.rate: unknown key `rate` (did you mean `nodes.train.params.rate`?)
    1: nodes.capture.txt: unknown key `txt` (did you mean `nodes.capture.params.text`?)
    1: stesp: unknown key `stesp` (did you mean `nodes.train.params.steps`?)
    ");
    let longer = ["train.steps=1", "train.params.steps=1", "train.over=[]", "params.steps=1", "foo.bar=1"];
    let found = longer.map(|text| errors(GRID, &[text])).concat();
    insta::assert_snapshot!(found.join("\n"), @r"
    1: train: unknown key `train` (did you mean `nodes.train.params.steps`?)
    1: train: unknown key `train` (did you mean `nodes.train.params.steps`?)
    1: train: unknown key `train` (did you mean `nodes.train.over`?)
    1: params: unknown key `params` (did you mean `nodes.train.params.steps`?)
    1: foo: unknown key `foo` (allowed: name, axes, nodes)
    ");
}

#[test]
fn a_misspelt_section_is_suggested_a_section() {
    let with = |section: &str| errors(&format!("{GRID}[{section}]\ntrials = 3\n"), &[]);
    assert_eq!(plan(&format!("{GRID}[sweep]\ntrials = 3\n"), &[]).nodes, plan(GRID, &[]).nodes);
    insta::assert_snapshot!([with("swep"), with("stride")].concat().join("\n"), @r"
    29: swep: unknown key `swep` (did you mean `sweep`? allowed: extends, name, axes, nodes, set, sweep)
    29: stride: unknown key `stride` (allowed: extends, name, axes, nodes, set, sweep)
    ");
}

#[test]
fn an_axis_that_no_node_runs_over_is_refused() {
    let unused = GRID.replace("seed = [0, 1]", "seed = [0, 1]\nmethods = [\"a\"]\nweight = [1]");
    insta::assert_snapshot!([errors(&unused, &[]), errors(GRID, &["axes.foo=[1, 2]"])].concat().join("\n"), @r#"
    6: axes.methods: no node runs over the axis `methods` (did you mean `method`? Otherwise add "methods" to the `over` of a node, or remove the axis)
    7: axes.weight: no node runs over the axis `weight` (add "weight" to the `over` of a node, or remove the axis)
    1: axes.foo: no node runs over the axis `foo` (add "foo" to the `over` of a node, or remove the axis)
    "#);
    // A recipe cannot remove the axes of its base.
    let over =
        "extends = [\"base.toml\"]\n[nodes.train]\nover = [\"scene\", \"method\"]\n[nodes.train.params]\nkeep = 1\n";
    let base = GRID.replace("\n[[set]]\nwhen = { seed = 1 }\nnodes.train.params.keep = 7\n", "");
    let recipes = Recipes::new(&[("base.toml", base.as_str()), ("main.toml", over)]);
    let plan = recipes.resolve("main.toml", &[]).unwrap_or_else(|errors| panic!("{errors}"));
    assert_eq!(plan.nodes.len(), 2 + 4 + 1);
}

#[test]
fn conditions_may_name_the_values_of_every_layer() {
    let main = "extends = [\"base.toml\"]\naxes.method = [\"d\"]\n";
    let base = GRID.replace("[\"a\", \"b\"]", "\"all\"");
    let recipes = Recipes::new(&[("base.toml", base.as_str()), ("main.toml", main)]);
    let values = axis_values(&recipes.path("main.toml"), &registry());
    assert_eq!(values["method"].iter().collect::<Vec<_>>(), ["a", "b", "c", "d"]);
    assert_eq!(values["seed"].iter().collect::<Vec<_>>(), ["0", "1"]);
}

#[test]
fn an_inherited_parameter_is_named_where_it_was_typed() {
    let first = GRID.replace("[nodes.capture]", "[nodes.warm]\nstage = \"test-work\"\nover = [\"seed\", \"scene\"]\nlike = { node = \"train\", method = \"a\" }\ninputs = { text = \"capture\" }\n[nodes.capture]");
    let with = |params: &str| errors(&first.replace("rate = 1 }", params), &[]);
    assert_eq!(with("stesp = 1 }")[0].split(':').nth(1), Some(" nodes.train.params.stesp"));
    assert_eq!(with("rate = \"x\" }")[0].split(':').nth(1), Some(" nodes.train.params.rate"));
    let by_rule = errors(&first, &["nodes.train.params.keep=-1", "nodes.warm.params.letter=1"]);
    let keys: Vec<_> = by_rule.iter().filter_map(|error| error.split(": ").nth(1)).collect();
    assert_eq!(keys, ["nodes.train.params.keep", "nodes.warm.params.letter"]);
}

#[test]
fn a_node_like_another_needs_its_new_axes() {
    let scaled = GRID
        .replace("[nodes.capture]", "[nodes.warm]\nstage = \"test-work\"\nover = [\"scene\"]\nlike = { node = \"train\", method = \"a\", seed = 0 }\ninputs = { text = \"capture\" }\n[nodes.capture]")
        .replace("seed = [0, 1]", "seed = [0, 1]\nscale = [1, 2]")
        .replace("rate = 1 }", "rate = \"{scale}\" }")
        .replace("over = [\"seed\",", "over = [\"scale\", \"seed\",");
    insta::assert_snapshot!(errors(&scaled, &[]).join("\n"), @r#"
    15: nodes.warm.like: node `warm` is `like` one job of `train`, but there is one for each scale (add "scale" to nodes.warm.over, or write nodes.warm.like = { node = "train", scale = … })
    "#);
    assert_eq!(plan(&scaled, &["nodes.warm.like.scale=2"]).nodes[2].params["rate"], json!(2.0));
}

#[test]
fn unsafe_names_are_refused() {
    let names = ["../../w", "..", "", "/w", "a/b", ".hidden"];
    let found: Vec<String> = names.iter().flat_map(|name| errors(GRID, &[&format!("name = \"{name}\"")])).collect();
    insta::assert_snapshot!(found.join("\n"), @r"
    1: name: `../../w` cannot be a recipe's name (use letters, digits, `_`, `-`, `+` and `.`, without a leading `.`)
    1: name: `..` cannot be a recipe's name (use letters, digits, `_`, `-`, `+` and `.`, without a leading `.`)
    1: name: `` cannot be a recipe's name (use letters, digits, `_`, `-`, `+` and `.`, without a leading `.`)
    1: name: `/w` cannot be a recipe's name (use letters, digits, `_`, `-`, `+` and `.`, without a leading `.`)
    1: name: `a/b` cannot be a recipe's name (use letters, digits, `_`, `-`, `+` and `.`, without a leading `.`)
    1: name: `.hidden` cannot be a recipe's name (use letters, digits, `_`, `-`, `+` and `.`, without a leading `.`)
    ");
    let found = errors(GRID, &["name = \"-x\"", "nodes.-y = { stage = \"test-write\" }", "axes.-z = [1]"]);
    insta::assert_snapshot!(found.join("\n"), @r"
    1: name: the name `-x` looks like an option (start it with a letter)
    1: nodes.-y: the name `-y` looks like an option (start it with a letter)
    1: axes.-z: the name `-z` looks like an option (start it with a letter)
    ");
    // An axis value may begin with `-`, because it follows the name of its node.
    assert_eq!(plan(GRID, &["axes.seed = [-1, 1]"]).nodes[1].name, "capture/lego");
    for (file, name) in [("...toml", "recipe"), ("..toml", "recipe"), ("-x.toml", "x"), ("my own.toml", "my own")] {
        assert_eq!(Recipes::new(&[(file, GRID)]).resolve(file, &[]).unwrap().recipe, name, "{file}");
    }
}

#[test]
fn a_recipe_with_too_many_jobs_is_refused() {
    let seeds: Vec<usize> = (0..10_000).collect();
    let found = errors(GRID, &[&format!("axes.seed = {seeds:?}")]);
    insta::assert_snapshot!(found.join("\n"), @"16: nodes.train.over: the recipe has 40003 jobs, of which 40000 of node `train` (at most 20000 can be planned; `train` has one job per combination: 2 of axis `scene` × 2 of axis `method` × 10000 of axis `seed`)");
}

#[test]
fn an_invalid_value_is_reported_once() {
    let out_of_range = "1: axes.seed: integer out of range";
    assert_eq!(errors(GRID, &["axes.seed = [18446744073709551616]"]), [out_of_range]);
    assert_eq!(
        errors(GRID, &["nodes.train.params.keep = {}"]),
        ["1: nodes.train.params.keep: invalid type: table, expected a non-negative whole number",]
    );
}

#[test]
fn an_option_sets_parameters_of_all_jobs_of_a_stage() {
    let recipes = Recipes::new(&[("recipe.toml", GRID)]);
    let resolved = |params: &str| {
        let of_stages =
            vec![StageOverride { stage: "test-work".into(), option: "--keep", params: params.into(), yields: false }];
        let overrides = Overrides { set: vec!["nodes.train.params.keep = 5".into()], of_stages };
        resolve_with(&recipes.path("recipe.toml"), &overrides, &registry(), recipes.0.path())
    };
    let plan = resolved("keep = 9").unwrap();
    let trained: Vec<_> = plan.nodes.iter().filter(|node| node.stage == "test-work").collect();
    assert!(trained.len() == 8 && trained.iter().all(|node| node.params["keep"] == 9));
    let error = resolved("keep = -1").unwrap_err().0.remove(0);
    assert_eq!((error.file.as_path(), error.key.as_str()), (Path::new("--keep"), "nodes.train.params.keep"));
}

#[test]
fn an_option_that_yields_replaces_only_what_a_recipe_inherits() {
    let own = "extends = [\"base.toml\"]\nnodes.train.params.keep = 3\n";
    let rule = "extends = [\"base.toml\"]\n[[set]]\nnodes.train.params.keep = 3\n";
    let base = GRID.replace("rate = 1 }", "rate = 1, keep = 1 }");
    let recipes = Recipes::new(&[
        ("base.toml", &*base),
        ("heir.toml", "extends = [\"base.toml\"]\n"),
        ("own.toml", own),
        ("rule.toml", rule),
    ]);
    let kept = |file: &str, set: &[&str]| {
        let of_stages = vec![StageOverride {
            stage: "test-work".into(),
            option: "--keep",
            params: "keep = 9".into(),
            yields: true,
        }];
        let overrides = Overrides { set: set.iter().map(|text| (*text).to_owned()).collect(), of_stages };
        let plan = resolve_with(&recipes.path(file), &overrides, &registry(), recipes.0.path()).unwrap();
        plan.nodes.iter().find(|node| node.stage == "test-work").unwrap().params["keep"].clone()
    };
    assert_eq!(kept("heir.toml", &[]), 9);
    assert_eq!([kept("base.toml", &[]), kept("own.toml", &[]), kept("rule.toml", &[])], [1, 3, 3]);
    assert_eq!(kept("heir.toml", &["nodes.train.params.keep = 5"]), 5);
}

#[test]
fn rules_that_cannot_apply_are_refused() {
    let text = GRID.replace("nodes.train.params.steps = 5", "nodes.capture.params.text = \"x\"");
    let expected =
        ["24: set.nodes.capture: this rule depends on axis `method`, over which node `capture` is not expanded"];
    assert_eq!(errors(&text, &[]), expected);
}

#[test]
fn conditions_are_values_or_arrays_of_values() {
    let with = |when: &str| errors(&GRID.replace("when = { seed = 1 }", &format!("when = {when}")), &[]);
    let all =
        ["{ seed = { except = [0] } }", "{ method = [] }", "{ seed = [1, true] }", "{ seed = 2 }"].map(with).concat();
    insta::assert_snapshot!(all.join("\n"), @r"
    27: set.when.seed: a condition is one value of the axis, or an array of at least one (allowed: 0, 1)
    27: set.when.method: a condition is one value of the axis, or an array of at least one (allowed: a, b)
    27: set.when.seed: a condition is one value of the axis, or an array of at least one (allowed: 0, 1)
    27: set.when.seed: axis `seed` has no value `2` (allowed: 0, 1)
    ");
}

#[test]
fn sources_outside_the_data_root_are_refused() {
    let text = "[nodes.a]\nstage = \"test-write\"\nparams.source = \"../x\"\n[nodes.b]\nstage = \"test-write\"\nparams.source = \"/x\"\n";
    insta::assert_snapshot!(errors(text, &[]).join("\n"), @r"
    3: nodes.a.params: source `text` must lie under the data root: ../x (write a relative path without `..`; --data-root sets the folder that it is relative to)
    6: nodes.b.params: source `text` must lie under the data root: /x (write a relative path without `..`; --data-root sets the folder that it is relative to)
    ");
}

#[test]
fn the_first_syntax_error_is_reported_with_a_caret() {
    let found = errors("a = \n[nodes\nb = 1 2\n", &[]);
    assert!(found.len() == 1 && found[0].starts_with("1: "), "{found:#?}");
    let open = errors("[axes]\nscene = [\"a\", \"b\"\nseed = [0]\n[nodes.x]\n", &[]);
    insta::assert_snapshot!(open.join("\n"), @r"
    3: : missing comma between array elements, expected `,` (or close the array with `]` on a line above)
    ");
    let recipes =
        Recipes::new(&[("recipe.toml", "[nodes.capture]\nstage = \"test-write\"\n\tparams = { \"tüxt\" = 1 }\n")]);
    let rendered = recipes.resolve("recipe.toml", &[]).unwrap_err().to_string();
    let expected = format!(
        "error: unknown key `tüxt`\n  at {}:3:13, key nodes.capture.params.tüxt\n  |  params = {{ \"tüxt\" = 1 }}\n  |             ^^^^^^\n  hint: did you mean `text`? allowed: text, source",
        recipes.path("recipe.toml").display()
    );
    assert_eq!(rendered, expected);
}

#[test]
fn a_recipe_without_nodes_is_refused() {
    assert_eq!(errors("", &[]), ["1: nodes: the recipe has no nodes (add [nodes.NAME] with a stage)"]);
    assert_eq!(errors("extends = \"x\"", &[]), ["1: extends: `extends` must be an array of file names"]);
}

#[test]
fn a_node_without_a_stage_is_one_error() {
    let text = "[nodes.a]\nover = []\n[nodes.b]\nstage = \"test-work\"\ninputs.text = \"a\"\n";
    assert_eq!(
        errors(text, &[]),
        ["1: nodes.a.stage: node `a` has no stage (allowed: test-join, test-list, test-work, test-write)"]
    );
    let misspelt = errors(&format!("{GRID}[nodes.trian]\nparams.steps = 1\n"), &[]);
    insta::assert_snapshot!(misspelt.join("\n"), @r"
    29: nodes.trian.stage: node `trian` has no stage (did you mean `train`? Otherwise set nodes.trian.stage)
    ");
}

#[test]
fn one_wrong_line_is_one_error_for_many_jobs() {
    let text = GRID
        .replace("steps = 3", "steps = \"{scene}\"")
        .replace("[[set]]\nwhen = { scene = \"ball\", method = [\"b\"] }\nnodes.train.params.steps = 5", "");
    let found = errors(&text, &[]);
    assert_eq!(
        found,
        [
            "20: nodes.train.params.steps: invalid type: string \"ball\", expected a non-negative whole number (the value comes from axis `scene` at line 3)"
        ]
    );
}

#[test]
fn a_wrong_axis_value_is_named_where_it_was_typed() {
    let base = GRID.replace("steps = 3", "steps = \"{seed}\"");
    let recipes =
        Recipes::new(&[("base.toml", base.as_str()), ("main.toml", "extends = [\"base.toml\"]\n\naxes.seed = [-1]\n")]);
    let hint = recipes.resolve("main.toml", &[]).unwrap_err().0.remove(0).hint.unwrap();
    assert_eq!(hint, format!("the value comes from axis `seed` at {}:3", recipes.path("main.toml").display()));
}

#[test]
fn only_restricts_a_node_to_some_values() {
    let text = GRID.replace(
        "over = [\"seed\", \"scene\", \"method\"]",
        "over = [\"seed\", \"scene\", \"method\"]\nonly = { scene = \"lego\", seed = [1] }",
    );
    let plan = plan(&text, &[]);
    let names: Vec<&str> = plan.nodes.iter().map(|node| node.name.as_str()).collect();
    assert_eq!(names, ["capture/ball", "capture/lego", "train/lego/a/1", "train/lego/b/1", "table"]);

    let wrong =
        |only: &str| errors(&GRID.replace("over = [\"scene\"]", &format!("over = [\"scene\"]\nonly = {only}")), &[]);
    let all = ["{ scene = \"bal\" }", "{ seed = 0 }", "{ speed = 0 }"].map(wrong).concat();
    insta::assert_snapshot!(all.join("\n"), @r"
    14: nodes.capture.only.scene: axis `scene` has no value `bal` (did you mean `ball`? allowed: ball, lego)
    14: nodes.capture.only: the node is not expanded over axis `seed` (add it to the node's `over`)
    14: nodes.capture.only.speed: unknown axis `speed` (did you mean `seed`? allowed: scene, method, seed)
    ");
    // Trainings on lego have no capture.
    insta::assert_snapshot!(wrong("{ scene = \"ball\" }").join("\n"), @"20: nodes.train.inputs.text: no producer on port `text` for some of the node's jobs (give this node the same `only` as its producer)");
}

#[test]
fn a_node_of_only_with_has_jobs_only_if_the_axis_has_the_value() {
    let with = |condition: &str| {
        let nodes = format!(
            "[nodes.extra]\nstage = \"test-write\"\nover = [\"scene\"]\nonly_with = {condition}\nparams.text = \"{{scene}}\"\n\
             [nodes.reader]\nstage = \"test-work\"\nover = [\"scene\"]\ninputs.text = \"extra\"\n[nodes.capture]"
        );
        GRID.replace("[nodes.capture]", &nodes).replace("[\"train\",", "[\"reader\", \"train\",")
    };
    let names = |overrides: &[&str]| -> Vec<String> {
        let plan = plan(&with("{ method = [\"b\"] }"), overrides);
        let of_reader = plan.nodes.iter().filter(|node| ["extra", "reader"].contains(&node.template.as_str()));
        of_reader.map(|node| node.name.clone()).chain(plan.left_out.iter().map(|name| format!("-{name}"))).collect()
    };
    assert_eq!(names(&[]), ["extra/ball", "extra/lego", "reader/ball", "reader/lego"]);
    let without = ["axes.method=[\"a\"]", "axes.scene=[\"ball\"]"];
    assert_eq!(names(&without), ["-extra/ball", "-reader/ball"], "the reader has no producer");
    let wrong =
        ["{ method = \"c\" }", "{ methd = \"a\" }", "\"method\""].map(|wrong| errors(&with(wrong), &[])).concat();
    insta::assert_snapshot!(wrong.join("\n"), @r"
    14: nodes.extra.only_with.method: axis `method` has no value `c` (allowed: a, b)
    14: nodes.extra.only_with.methd: unknown axis `methd` (did you mean `method`? allowed: scene, method, seed)
    14: nodes.extra.only_with: `only_with` must be a table
    ");
}

#[test]
fn idle_axes_are_found_at_the_first_node() {
    let idle = |text: &str, overrides: &[&str]| -> Vec<String> {
        plan(text, overrides).idle_axes().iter().map(ToString::to_string).collect()
    };
    let fixed = GRID.replace("when = { seed = 1 }", "when = { seed = [0, 1] }");
    assert_eq!(idle(&fixed, &[]), ["axis `seed` changes nothing: train/ball/a/0 and train/ball/a/1 are the same job"]);
    assert_eq!(idle(&fixed, &["axes.seed=[1]"]), [""; 0], "an axis with one value is never idle");
    // One job that differs is enough.
    let one = GRID.replace("when = { seed = 1 }", "when = { seed = 1, scene = \"lego\", method = \"b\" }");
    assert_eq!((idle(GRID, &[]), idle(&one, &[])), (Vec::new(), Vec::new()));
}

#[test]
fn an_axis_of_all_equals_the_list_of_its_values() {
    let with = |values: &str| GRID.replace("method = [\"a\", \"b\"]", &format!("method = {values}"));
    let listed = plan(&with("[\"a\", \"b\", \"c\"]"), &[]);
    // The origins differ in the file: every plan has a temporary recipe.
    assert_eq!(plan(&with("\"all\""), &[]).nodes, listed.nodes);
    assert_eq!(plan(GRID, &["axes.method=\"all\""]).nodes, listed.nodes);
    assert_eq!(plan(&with("{ except = [\"c\"] }"), &[]).nodes, plan(GRID, &[]).nodes);
    // Rules may name every value, even where an override narrows the axis.
    let rule = "[[set]]\nwhen.method = \"c\"\nnodes.train.params.keep = 3\n";
    let narrowed = plan(&(with("\"all\"") + rule), &["axes.method=[\"a\"]"]);
    assert!(narrowed.nodes.iter().all(|node| node.coordinates.get("method").is_none_or(|method| method == "a")));
}

#[test]
fn an_axis_of_all_needs_a_stage_that_lists_its_values() {
    let with = |axis: &str| errors(GRID, &[&format!("axes.{axis}")]);
    let found =
        ["seed = \"all\"", "method = { except = [\"d\", \"c\"] }", "method = { but = [\"c\"] }", "method = \"a\""];
    let all: Vec<String> =
        found.iter().flat_map(|axis| with(axis)).filter(|error| error.starts_with("1: axes")).collect();
    insta::assert_snapshot!(all.join("\n"), @r#"
    1: axes.seed: unknown values of axis `seed` (write them as an array: no stage lists the values of a parameter that is "{seed}")
    1: axes.method: axis `method` has no value `d` (allowed: a, b, c)
    1: axes.method: unknown key `but` (allowed: except)
    1: axes.method: an axis is an array of strings or numbers (or "all", or { except = […] }, where a stage lists the values)
    "#);
}

use crate::plan::{Origin, Plan};
use crate::recipe::tests::{errors, plan};

/// A recipe with the texts `a` and `b` for each seed, joined and listed. `suffix` adds inputs to the join; `params`
/// sets its parameters.
fn recipe(suffix: &str, params: &str) -> String {
    format!(
        r#"
[axes]
seed = [0, 1]
[nodes.a]
stage = "test-write"
over = ["seed"]
params.text = "a"
[nodes.b]
stage = "test-write"
over = ["seed"]
params.text = "b"
[nodes.joined]
stage = "test-join"
over = ["seed"]
inputs = {{ text = "a"{suffix} }}
{params}
[nodes.list]
stage = "test-list"
inputs.texts = "joined"
"#
    )
}

const WIRED: &str = ", suffix = \"b\"";

fn names(plan: &Plan) -> Vec<&str> {
    plan.nodes.iter().map(|node| node.name.as_str()).collect()
}

fn joined(plan: &Plan) -> &crate::Node {
    &plan.nodes[plan.index_of("joined/1").unwrap()]
}

#[test]
fn an_optional_port_has_one_producer_or_none() {
    let plan_of = |suffix: &str| plan(&recipe(suffix, "params.suffix = false"), &[]);
    assert_eq!(plan_of("").nodes, plan_of(", suffix = []").nodes);
    assert_eq!(plan(&recipe(WIRED, ""), &[]).nodes[5].inputs[1].producers, [3]);
    let two = errors(&recipe(", suffix = [\"a\", \"b\"]", ""), &[]);
    assert_eq!(two, ["15: nodes.joined.inputs.suffix: port `suffix` takes at most one producer, not 2"]);
    let over_none = recipe(WIRED, "").replace("stage = \"test-join\"\nover = [\"seed\"]", "stage = \"test-join\"");
    insta::assert_snapshot!(errors(&over_none, &[]).join("\n"), @r"
    14: nodes.joined.inputs.text: port `text` takes one producer, but there is one `a` for each seed (add seed to nodes.joined.over)
    14: nodes.joined.inputs.suffix: port `suffix` takes one producer, but there is one `b` for each seed (add seed to nodes.joined.over)
    ");
}

#[test]
fn jobs_that_repeat_others_leave_the_plan_with_their_readers() {
    let rule = "[[set]]\nwhen = { seed = 1 }\nnodes.joined.params.repeats = true\n";
    let reader = "[nodes.copy]\nstage = \"test-join\"\nover = [\"seed\"]\ninputs.text = \"joined\"\n";
    let plan = plan(&(recipe(WIRED, "") + reader + rule), &[]);
    assert_eq!(names(&plan), ["a/0", "b/0", "joined/0", "list", "copy/0"]);
    assert_eq!(plan.left_out, ["joined/1", "copy/1", "a/1", "b/1"]);
    assert_eq!(plan.nodes[3].inputs[0].producers, [2], "a job that collects the others goes without them");
}

#[test]
fn unread_inputs_are_pruned_with_their_jobs() {
    let with = plan(&recipe(WIRED, ""), &[]);
    assert_eq!(names(&with), ["a/0", "a/1", "b/0", "b/1", "joined/0", "joined/1", "list"]);
    assert_eq!(joined(&with).inputs[1].producers, [3]);
    let without = plan(&recipe(WIRED, "params.suffix = false"), &[]);
    assert_eq!(names(&without), ["a/0", "a/1", "joined/0", "joined/1", "list"]);
    assert_eq!(without.left_out, ["b/0", "b/1"]);
    assert!(!without.origins.contains_key("b/0"));
    assert_eq!(without.nodes[4].inputs[0].producers, [2, 3]);
    // A node that is not wired to any other stays.
    let unwired = plan(&recipe("", ""), &[]);
    assert_eq!((unwired.nodes.len(), unwired.left_out.len()), (7, 0));
}

#[test]
fn producers_of_pruned_jobs_are_pruned() {
    let chain = "[nodes.c]\nstage = \"test-work\"\nover = [\"seed\"]\ninputs.text = \"b\"\n";
    let text = recipe(", suffix = \"c\"", "params.suffix = false") + chain;
    assert_eq!(names(&plan(&text, &[])), ["a/0", "a/1", "joined/0", "joined/1", "list"]);
    // With another reader it stays.
    let also = text + "[nodes.other]\nstage = \"test-list\"\ninputs.texts = \"b\"\n";
    assert_eq!(plan(&also, &[]).left_out, ["c/0", "c/1"]);
}

#[test]
fn a_port_of_choice_reads_one_of_its_producers() {
    let ending = |nodes: &str, overrides: &[&str]| {
        let plan = plan(&recipe(&format!(", ending = {nodes}"), ""), overrides);
        let read = joined(&plan).inputs[2].producers.iter().map(|&index| plan.nodes[index].name.clone());
        (read.collect::<Vec<_>>(), plan.left_out.clone())
    };
    assert_eq!(ending("[\"b\", \"a\"]", &[]), (vec!["b/1".to_string()], vec![]));
    let without_b = (vec!["a/1".to_string()], vec!["b/0".to_string(), "b/1".to_string()]);
    assert_eq!(ending("[\"b\", \"a\"]", &["nodes.b.params.text=''"]), without_b);
    assert_eq!(ending("\"b\"", &["nodes.b.params.text=''"]).0, Vec::<String>::new());
}

#[test]
fn a_node_like_another_starts_from_its_parameters_and_rules() {
    let text = r#"
[axes]
scene = ["ball", "lego"]
method = ["m", "n"]
[nodes.a]
stage = "test-write"
[nodes.work]
stage = "test-work"
over = ["scene", "method"]
inputs.text = "a"
params = { letter = "{method}", steps = 3, rate = 0.5 }
[nodes.first]
stage = "test-work"
like = { node = "work", method = "o" }
over = ["scene"]
inputs.text = "a"
params = { fail = "" }
[[set]]
when.scene = "lego"
nodes.work.params.steps = 5
[[set]]
when.method = "n"
nodes.work.params.steps = 7
[[set]]
nodes.first.params.keep = 9
"#;
    let plan = plan(text, &["nodes.work.params.rate=0.25"]);
    let params = |name: &str| {
        let params = &plan.nodes[plan.index_of(name).unwrap()].params;
        let text = |key: &str| params[key].to_string();
        [text("letter"), text("steps"), text("rate"), text("keep")].join(" ")
    };
    // `like` may fix an axis at a value that the axis does not have.
    assert_eq!(params("first/ball"), r#""o" 3 0.25 9"#);
    assert_eq!(params("first/lego"), r#""o" 5 0.25 9"#);
    assert!(params("work/lego/n").starts_with(r#""n" 7 0.25"#));
    let like = |other: &str| errors(&text.replace("{ node = \"work\", method = \"o\" }", other), &[]);
    let found = [
        ("\"wrok\"", "unknown node `wrok` (did you mean `work`? allowed: a, work, first)"),
        ("\"a\"", "node `a` is of stage `test-write` (`like` takes nodes of the same stage)"),
        ("\"first\"", "node `first` itself uses `like`"),
        (
            "\"work\"",
            "node `first` is `like` one job of `work`, but there is one for each method (add \"method\" to nodes.first.over, or write nodes.first.like = { node = \"work\", method = … })",
        ),
        ("{ method = \"n\" }", "`like` must name a node, e.g. { node = \"train\" }"),
        (
            "{ node = \"work\", methd = \"n\" }",
            "unknown axis `methd` (did you mean `method`? allowed: scene, method, node)",
        ),
    ];
    for (other, message) in found {
        assert!(like(other).contains(&format!("14: nodes.first.like: {message}")), "{:?}", like(other));
    }
}

#[test]
fn resolved_and_named_choices_have_one_key() {
    let ids = |suffix: &str, params: &str, overrides: &[&str]| {
        let plan = plan(&recipe(suffix, params), overrides);
        plan.nodes.iter().map(|node| (node.name.clone(), node.plan_id.clone())).collect::<Vec<_>>()
    };
    assert_eq!(ids(WIRED, "", &[]), ids(WIRED, "params.suffix = true", &[]));
    let empty = "nodes.b.params.text=''";
    assert_eq!(ids(WIRED, "", &[empty]), ids(WIRED, "params.suffix = false", &[]));
    assert_ne!(ids(WIRED, "", &[]), ids(WIRED, "", &[empty]));
}

#[test]
fn decisions_and_origins_show_the_resolution() {
    let plan = plan(&recipe(WIRED, ""), &["nodes.b.params.text=''"]);
    let decision = &joined(&plan).decisions[0];
    assert_eq!((decision.effect.as_str(), decision.on, decision.reason.as_str()), ("suffix", false, "empty"));
    assert_eq!(plan.origins["joined/1"]["suffix"], Origin::Resolved);
    let named = self::plan(&recipe(WIRED, "params.suffix = true"), &[]);
    assert!(matches!(named.origins["joined/1"]["suffix"], Origin::File { line: 16, .. }));
}

#[test]
fn facts_of_missing_data_are_unknown() {
    let with_source = |path: &str| {
        let params = format!("nodes.b.params={{ text = '', source = '{path}' }}");
        joined(&plan(&recipe(WIRED, ""), &[&params])).decisions[0].reason.clone()
    };
    assert_eq!(with_source("nowhere.txt"), "unknown before it is read");
    assert_eq!(with_source("recipe.toml"), "not empty");
}

#[test]
fn an_impossible_choice_is_an_error_of_the_recipe() {
    let found = errors(&recipe("", "params.suffix = true"), &[]);
    assert_eq!(
        found,
        ["16: nodes.joined.params.suffix: nothing is wired to it (wire `suffix` to a node, or remove the key)"]
    );
}

//! Help, usage errors and messages of the command line, and the commands that the README names.

use std::collections::BTreeSet;

use crate::product::{Ended, program, root};
use crate::tidy::tracked_files;

/// The verbs that `--help` lists, except `help` itself.
fn verbs() -> BTreeSet<String> {
    let help = Ended::of(program(&["--help"])).ok();
    let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| line.starts_with("  "));
    let words = listed.filter_map(|line| line.split_whitespace().next());
    words.filter(|verb| *verb != "help").map(str::to_owned).collect()
}

#[test]
fn every_verb_has_help() {
    let verbs = verbs();
    let expected = "attach cache cancel compare completions data doctor eval explain export graph inspect plan prepare recipes render run show status table worker";
    assert_eq!(verbs.iter().map(String::as_str).collect::<Vec<_>>().join(" "), expected);
    for verb in verbs {
        let help = Ended::of(program(&[&verb, "--help"])).ok();
        assert!(help.contains("Usage: ") && help.lines().count() > 4, "{verb}:\n{help}");
    }
    assert!(Ended::of(program(&["--help"])).ok().contains("Exit codes"));
    assert!(Ended::of(program(&["--version"])).ok().starts_with("pipeline "));
    assert_eq!(Ended::of(program(&["no-such-verb"])).code, 2);
}

/// Standard error with the workspace's folder replaced by `ROOT` and the list of all methods by `METHODS`, so that a new
/// method changes no snapshot.
fn message(ended: &Ended) -> String {
    let methods = cli::stages().get("training").and_then(|stage| stage.values("method")).expect("a list of methods");
    ended.stderr.replace(&root().display().to_string(), "ROOT").replace(&methods.join(", "), "METHODS")
}

#[test]
fn errors_of_recipes_name_place_and_suggestion() {
    let recipe = root().join("recipes/quickstart.toml").display().to_string();
    let mut messages = String::new();
    for value in [
        "axes.method=[\"statc3dgs\"]",
        "nodes.train.params.effects=\"none\"",
        "nodes.train.params.density.max_count=-1",
        "nodes.train.params.desnity.max_count=1",
        "nodes.trian.params.seed=1",
        "axes.scene=[]",
        "name=\"../../w\"",
    ] {
        let refused = Ended::of(program(&["plan", &recipe, "-s", value]));
        assert_eq!(refused.code, 3, "{value}\n{}", refused.stderr);
        messages += &format!("-s {value}\n{}\n", message(&refused));
    }
    insta::assert_snapshot!(messages);
}

#[test]
fn wrong_names_and_paths_have_messages_with_hints() {
    let recipe = root().join("recipes/quickstart.toml").display().to_string();
    let folder = tempfile::tempdir().expect("a folder for the test");
    let store = folder.path().join("store").display().to_string();
    let mut messages = String::new();
    for (code, arguments) in [
        (3, &["plan", "no-such-recipe.toml"][..]),
        (4, &["plan", &recipe, "--only", "trian/*"]),
        (4, &["explain", &recipe, "train/swinging-arm"]),
        (4, &["show", &recipe, "train/swinging-arm/static3dgs/0"]),
        (4, &["export", &recipe, "report", "--times=0:1:2", "--out=o"]),
        (4, &["table", &recipe]),
        (3, &["compare", "no-such-report.json", &recipe]),
        (5, &["run", &recipe, "--frozen"]),
        (3, &["inspect", "no-such-folder"]),
        (3, &["eval", "--renders=no-such-folder", "--truth=no-such-folder"]),
        (3, &["eval", "--renders=Cargo.toml", "--truth=no-such-folder"]),
        (4, &["cache", "du"]),
    ] {
        let ended = Ended::of(program(&[arguments, &["--store", &store]].concat()));
        assert_eq!(ended.code, code, "{arguments:?}\n{}", ended.stderr);
        let line = arguments.join(" ").replace(&recipe, "RECIPE");
        messages += &format!("{line}\n{}\n", message(&ended).replace(&store, "STORE").replace(&recipe, "RECIPE"));
    }
    insta::assert_snapshot!(messages);
}

#[test]
fn an_empty_variable_is_none_and_an_empty_option_is_refused() {
    let recipe = root().join("recipes/quickstart.toml").display().to_string();
    let mut cleared = program(&["plan", &recipe]);
    cleared.envs(["PIPELINE_STORE", "PIPELINE_DATA", "PIPELINE_DEVICE"].map(|name| (name, "")));
    Ended::of(cleared).ok();
    for wrong in ["--device=", "--budget=0s", "--replicates=100000", "--store="] {
        assert_eq!(Ended::of(program(&["plan", &recipe, wrong])).code, 2, "{wrong}");
    }
}

#[test]
fn doctor_reports_whether_a_store_can_be_created() {
    let folder = tempfile::tempdir().expect("a folder for the test");
    let (file, missing) = (folder.path().join("file"), folder.path().join("store"));
    std::fs::write(&file, "").expect("the file is written");
    let of_store = |store: &std::path::Path| {
        let store = store.display().to_string();
        Ended::of(program(&["doctor", "--device", "cpu", "--store", &store]))
    };
    let output = of_store(&missing).ok();
    assert!(output.contains("the first run creates it") && output.contains("none requested"), "{output}");
    assert!(!missing.exists());
    // The variable of `program` is read, too.
    let of_variable = Ended::of(program(&["doctor", "--store", &missing.display().to_string()])).ok();
    assert!(of_variable.contains("none requested"), "{of_variable}");
    let output = of_store(&file.join("store"));
    assert!(output.code == 13 && output.stdout.contains("NOT USABLE: it cannot be created"), "{}", output.stdout);
}

/// The verbs that a page names: after `cargo run --release --`, and in the first column of the table under a heading
/// that speaks of verbs.
fn commands(page: &str) -> Vec<String> {
    let after_cargo = page.split("cargo run --release -- ").skip(1).filter_map(|rest| rest.split_whitespace().next());
    let sections =
        page.split("\n## ").filter(|section| section.lines().next().is_some_and(|line| line.contains("verbs")));
    let rows = sections.flat_map(str::lines).filter(|line| line.starts_with("| `"));
    let in_rows = rows.flat_map(|row| row.split('|').nth(1).unwrap_or_default().split('`').skip(1).step_by(2));
    let names = after_cargo.chain(in_rows.filter_map(|command| command.split_whitespace().next()));
    // Leaves out options.
    let is_verb = |name: &&str| name.chars().all(|c| c.is_ascii_lowercase() || c == '-') && !name.starts_with('-');
    names.map(|name| name.trim_matches('`')).filter(is_verb).map(str::to_owned).collect()
}

/// All tracked Markdown pages.
pub(crate) fn pages() -> Vec<(String, String)> {
    tracked_files().into_iter().filter(|(name, _)| name.ends_with(".md")).collect()
}

#[test]
fn pages_name_verbs_that_exist() {
    let verbs = verbs();
    let named: Vec<_> = pages()
        .iter()
        .flat_map(|(name, page)| commands(page).into_iter().map(|verb| (name.clone(), verb)).collect::<Vec<_>>())
        .collect();
    assert!(named.contains(&("README.md".into(), "run".into())), "{named:?}");
    let unknown: Vec<_> = named.iter().filter(|(_, verb)| !verbs.contains(verb)).collect();
    assert!(unknown.is_empty(), "{unknown:?} are none of {verbs:?}");
    assert_eq!(commands("cargo run --release -- rnu x\n## All verbs\n| `exprot A` | b |"), ["rnu", "exprot"]);
}

/// The recipes that a page names, without patterns and placeholders.
fn recipes(page: &str) -> BTreeSet<&str> {
    let words = page.split(|c: char| c.is_whitespace() || "`()[],;:".contains(c));
    let is_recipe = |word: &&str| word.starts_with("recipes/") && word.ends_with(".toml");
    words.filter(is_recipe).filter(|word| !word.contains('*') && !word.contains("NAME")).collect()
}

/// The recipes that a page names and that do not exist. A recipe that a command on the page writes is not expected.
fn missing_recipes(page: &str) -> Vec<&str> {
    let is_written = |recipe: &str| page.contains(&format!("> {recipe}\n"));
    recipes(page).into_iter().filter(|recipe| !is_written(recipe) && !root().join(recipe).is_file()).collect()
}

#[test]
fn pages_name_recipes_that_exist() {
    let pages = pages();
    for (name, page) in &pages {
        assert_eq!(missing_recipes(page), Vec::<&str>::new(), "{name}");
    }
    let readme = pages.iter().find(|(name, _)| name == "README.md").expect("the README is tracked");
    assert!(recipes(&readme.1).contains("recipes/quickstart.toml"));
    let page = "run `recipes/qiuckstart.toml`\ninspect > recipes/mine.toml\nrun recipes/mine.toml";
    assert_eq!(missing_recipes(page), ["recipes/qiuckstart.toml"]);
}

#[test]
fn a_recipe_for_a_part_of_the_captures_names_the_others() {
    let folder = tempfile::tempdir().expect("a folder for the test");
    for name in ["good", "bad"] {
        support::fakes::Fake::small(2, 4).dnerf(&folder.path().join(name));
    }
    let transforms = folder.path().join("bad/transforms_train.json");
    let text = std::fs::read_to_string(&transforms).expect("the file is read");
    std::fs::write(&transforms, text.replace("\"camera_angle_x\"", "\"unknown\"")).expect("the file is written");
    let dir = folder.path().display().to_string();
    let ended = Ended::of(program(&["inspect", &dir, "--recipe"]));
    assert!(ended.code == 3 && ended.stdout.contains("scene = [\"good\"]"), "{}", ended.stdout);
    let expected = ["left out of the recipe: bad", "`pipeline inspect` without --recipe lists the problems"];
    assert!(expected.iter().all(|part| ended.stderr.contains(part)), "{}", ended.stderr);
    assert!(!ended.stderr.contains("listed above"), "{}", ended.stderr);
    let ended = Ended::of(program(&["inspect", &dir]));
    assert!(ended.code == 3 && ended.stderr.contains("the problems are listed above"), "{}", ended.stderr);
}

//! The command line explains itself, and the README names what exists.

use std::collections::BTreeSet;

use crate::product::{Ended, program, root};

/// The verbs that `--help` lists, without `help` itself.
fn verbs() -> BTreeSet<String> {
    let help = Ended::of(program(&["--help"])).ok();
    let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| line.starts_with("  "));
    let words = listed.filter_map(|line| line.split_whitespace().next());
    words.filter(|verb| *verb != "help").map(str::to_owned).collect()
}

#[test]
fn every_verb_has_help() {
    let verbs = verbs();
    for expected in ["run", "plan", "explain", "status", "graph", "show", "table", "export", "inspect", "eval", "cache"]
    {
        assert!(verbs.contains(expected), "{verbs:?}");
    }
    for verb in verbs {
        let help = Ended::of(program(&[&verb, "--help"])).ok();
        assert!(help.contains("Usage: ") && help.lines().count() > 4, "{verb}:\n{help}");
    }
    assert!(Ended::of(program(&["--help"])).ok().contains("Exit codes"));
    assert!(Ended::of(program(&["--version"])).ok().starts_with("pipeline "));
    assert_eq!(Ended::of(program(&["no-such-verb"])).code, 2);
}

#[test]
fn errors_are_in_the_words_of_recipes() {
    let recipe = root().join("recipes/quickstart.toml").display().to_string();
    for (value, told) in [
        ("axes.method=[\"statc3dgs\"]", "did you mean `static3dgs`?"),
        ("nodes.train.params.effects=\"none\"", "effects must be \"auto\" or a list of names, not \"none\""),
        ("nodes.train.params.density.max_count=-1", "expected a whole number from 0 on"),
        ("name=\"../../w\"", "`../../w` cannot be a recipe's name"),
    ] {
        let refused = Ended::of(program(&["plan", &recipe, "-s", value]));
        assert!(refused.code == 3 && refused.stderr.contains(told), "{value}\n{}", refused.stderr);
    }
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
fn doctor_tells_whether_a_store_can_be_made() {
    let folder = tempfile::tempdir().expect("a folder for the test");
    let (file, place) = (folder.path().join("file"), folder.path().join("store"));
    std::fs::write(&file, "").expect("the file is written");
    let of_store = |store: &std::path::Path| {
        let store = store.display().to_string();
        Ended::of(program(&["doctor", "--device", "cpu", "--store", &store]))
    };
    let told = of_store(&place).ok();
    assert!(told.contains("the first run makes it") && told.contains("none asked for") && !place.exists(), "{told}");
    let told = of_store(&file.join("store"));
    assert!(told.code == 13 && told.stdout.contains("NOT USABLE: it cannot be made"), "{}", told.stdout);
}

/// The program's commands in a text: what follows `cargo run --release --`, and the first words in the table below the
/// heading of verbs.
fn commands(text: &str) -> Vec<String> {
    let after_cargo = text.split("cargo run --release -- ").skip(1).filter_map(|rest| rest.split_whitespace().next());
    let section =
        text.split("## Everyday verbs").nth(1).and_then(|rest| rest.split("\n## ").next()).unwrap_or_default();
    let rows = section.lines().filter(|line| line.starts_with("| `"));
    let in_rows = rows.flat_map(|row| row.split('|').nth(1).unwrap_or_default().split('`').skip(1).step_by(2));
    let names = after_cargo.chain(in_rows.filter_map(|command| command.split_whitespace().next()));
    // Options are no verbs.
    let is_verb = |name: &&str| name.chars().all(|c| c.is_ascii_lowercase() || c == '-') && !name.starts_with('-');
    names.map(|name| name.trim_matches('`')).filter(is_verb).map(str::to_owned).collect()
}

#[test]
fn the_readme_names_verbs_that_exist() {
    let (verbs, readme) = (verbs(), std::fs::read_to_string(root().join("README.md")).expect("the README is there"));
    let named = commands(&readme);
    assert!(named.len() >= 8 && named.contains(&"run".to_owned()), "{named:?}");
    for verb in named {
        assert!(verbs.contains(&verb), "the README names `{verb}`, which is none of {verbs:?}");
    }
    assert_eq!(commands("cargo run --release -- rnu x\n## Everyday verbs\n| `exprot A` | b |"), ["rnu", "exprot"]);
}

/// The recipes that a text names.
fn recipes(text: &str) -> BTreeSet<&str> {
    let words = text.split(|c: char| c.is_whitespace() || c == '`' || c == '(' || c == ')');
    words.filter(|word| word.starts_with("recipes/") && word.ends_with(".toml")).collect()
}

#[test]
fn the_readme_names_recipes_that_exist() {
    let readme = std::fs::read_to_string(root().join("README.md")).expect("the README is there");
    let named = recipes(&readme);
    assert!(named.contains("recipes/quickstart.toml"), "{named:?}");
    // What a command of the README writes itself is there once it ran.
    let is_written = |recipe: &str| readme.contains(&format!("> {recipe}\n"));
    for recipe in named.into_iter().filter(|recipe| !is_written(recipe)) {
        assert!(root().join(recipe).is_file(), "the README names {recipe}");
    }
}

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
    for recipe in named {
        assert!(root().join(recipe).is_file(), "the README names {recipe}");
    }
}

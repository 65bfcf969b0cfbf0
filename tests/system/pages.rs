//! Commands and recipes that pages show: each can be planned, so that no page names a key, value or file that does not exist.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::command_line::pages;
use crate::product::root;

/// The fenced blocks of a page in one language, and the page without any fenced block.
fn blocks<'a>(page: &'a str, language: &str) -> (Vec<&'a str>, String) {
    let (mut blocks, mut rest) = (Vec::new(), String::new());
    for (index, part) in page.split("```").enumerate() {
        match (index % 2, part.strip_prefix(language)) {
            (0, _) => rest.push_str(part),
            (_, Some(block)) => blocks.push(block),
            (_, None) => {}
        }
    }
    (blocks, rest)
}

/// The `run` commands of a page, in blocks and in code spans, without those that have placeholders: from the recipe on.
fn run_commands(page: &str) -> Vec<String> {
    let page = page.replace("\\\n", " ");
    let (shell, text) = blocks(&page, "sh");
    let lines = shell.into_iter().flat_map(str::lines).map(str::to_owned);
    let spans = text.split('`').skip(1).step_by(2).map(|span| span.split_whitespace().collect::<Vec<_>>().join(" "));
    let of_program = |command: String| {
        let command = command.strip_prefix("cargo run --release -- run ").or(command.strip_prefix("pipeline run "))?;
        let has_placeholder =
            ["NAME", "RECIPE", "…", "mine.toml", "own-clip.toml"].iter().any(|it| command.contains(it));
        (!has_placeholder).then(|| command.to_owned())
    };
    lines.chain(spans).filter_map(of_program).collect()
}

/// The words of a command as a shell splits them.
fn words(command: &str) -> Vec<String> {
    let output = Command::new("sh").args(["-c", &format!("printf '%s\\0' {command}")]).output().expect("sh starts");
    assert!(output.status.success(), "{command}: {}", String::from_utf8_lossy(&output.stderr));
    let output = String::from_utf8(output.stdout).expect("the words are UTF-8");
    output.split_terminator('\0').map(str::to_owned).collect()
}

/// What is wrong with a command that runs a recipe, if anything.
fn refusal(command: &str) -> Option<String> {
    let words = words(command);
    let recipe = words.first().expect("a recipe follows `run`");
    let recipe = if recipe.starts_with("builtin:") { PathBuf::from(recipe) } else { root().join(recipe) };
    let sets = words.windows(2).filter(|pair| pair[0] == "-s" || pair[0] == "--set").map(|pair| pair[1].clone());
    let plan = engine::recipe::resolve(&recipe, &sets.collect::<Vec<_>>(), &cli::stages(), Path::new("data"));
    plan.err().map(|errors| errors.to_string())
}

#[test]
fn commands_on_pages_plan() {
    let mut count = 0;
    for (name, page) in pages() {
        for command in run_commands(&page) {
            count += 1;
            assert_eq!(refusal(&command), None, "{name}: run {command}");
        }
    }
    assert!(count >= 10, "only {count} commands are found");
    let page =
        "```sh\npipeline run recipes/ci.toml \\\n  -s 'axes.scene=[1]'  # one\n```\n`pipeline run\nrecipes/x.toml`";
    assert_eq!(run_commands(page), ["recipes/ci.toml    -s 'axes.scene=[1]'  # one", "recipes/x.toml"]);
    assert_eq!(
        words("recipes/ci.toml -s 'axes.scene=[\"a b\"]' # one"),
        ["recipes/ci.toml", "-s", "axes.scene=[\"a b\"]"]
    );
    let wrong = refusal("recipes/ci.toml -s nodes.train.params.iteration.fine=3").expect("the key does not exist");
    assert!(wrong.contains("iteration"), "{wrong}");
}

#[test]
fn recipes_on_pages_plan() {
    let folder = tempfile::tempdir().expect("a folder for the recipes");
    let mut count = 0;
    for (name, page) in pages().into_iter().filter(|(name, _)| name.ends_with("README.md")) {
        for block in blocks(&page, "toml").0.into_iter().filter(|block| block.trim_start().starts_with("extends")) {
            let mut recipe: toml::Table =
                toml::from_str(block).unwrap_or_else(|error| panic!("{name}: {error}\n{block}"));
            let extends = recipe.get_mut("extends").and_then(toml::Value::as_array_mut).expect("a list of recipes");
            count += 1;
            // A recipe of a user is in the folder of the recipes that it extends.
            for base in
                extends.iter_mut().filter(|base| base.as_str().is_some_and(|base| !base.starts_with("builtin:")))
            {
                *base = root().join("recipes").join(base.as_str().expect("a path")).display().to_string().into();
            }
            let path = folder.path().join(format!("{count}.toml"));
            std::fs::write(&path, toml::to_string(&recipe).expect("a table")).expect("the recipe is written");
            if let Err(errors) = engine::recipe::resolve(&path, &[], &cli::stages(), Path::new("data")) {
                panic!("{name}:\n{block}\n{errors}");
            }
        }
    }
    assert!(count >= 1, "no recipe is found");
}

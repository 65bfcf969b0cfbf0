//! Every known danger of the arithmetic has a test that exists, or a reason why it cannot occur.

use crate::product::root;
use walkdir::WalkDir;

const CATALOGUE: &str = "tests/numerics.md";
/// Entries of the catalogue.
const DANGERS: usize = 45;
/// Letters of the shortest reason that says anything.
const SHORTEST_REASON: usize = 40;

/// All Rust sources of the project.
fn sources() -> String {
    let folders = ["pipeline", "stages", "shaders", "tests"].map(|folder| root().join(folder));
    let files =
        folders.iter().flat_map(|folder| WalkDir::new(folder).into_iter().map(|entry| entry.expect("readable")));
    let paths = files.map(walkdir::DirEntry::into_path).filter(|path| path.extension().is_some_and(|it| it == "rs"));
    paths.map(|path| std::fs::read_to_string(path).expect("a source is text")).collect()
}

/// What is wrong with a catalogue, given the sources.
fn problems(catalogue: &str, sources: &str) -> Vec<String> {
    let rows: Vec<&str> = catalogue.lines().filter(|line| line.starts_with("| N")).collect();
    let mut problems = Vec::new();
    for number in 1..=DANGERS {
        let head = format!("| N{number} |");
        let own: Vec<_> = rows.iter().filter(|row| row.starts_with(&head)).collect();
        let [row] = own[..] else {
            problems.push(format!("{} rows for N{number}", own.len()));
            continue;
        };
        let evidence = row.split('|').nth(3).unwrap_or_default();
        let tests: Vec<&str> = evidence.split('`').skip(1).step_by(2).filter(|word| word.contains('_')).collect();
        let unknown = tests.iter().filter(|test| !sources.contains(&format!("fn {test}(")));
        problems.extend(unknown.map(|test| format!("N{number} names `{test}`, which is no test")));
        let reason = evidence.split_once("cannot occur:").map_or("", |(_, reason)| reason.trim());
        if tests.is_empty() && reason.chars().count() < SHORTEST_REASON {
            problems.push(format!("N{number} has neither a test nor a reason"));
        }
    }
    problems
}

#[test]
fn every_numerical_danger_has_a_test_or_a_reason() {
    let catalogue = std::fs::read_to_string(root().join(CATALOGUE)).expect("the catalogue is there");
    assert_eq!(problems(&catalogue, &sources()), Vec::<String>::new());
}

#[test]
fn a_hole_in_the_catalogue_is_noticed() {
    let row = |number: usize| format!("| N{number} | x | `a_test` |\n");
    let whole: String = (1..=DANGERS).map(row).collect();
    assert_eq!(problems(&whole, "fn a_test() {}"), Vec::<String>::new());
    assert_eq!(problems(&whole, "fn another() {}").len(), DANGERS);
    let hole = whole.replace(&row(7), "");
    assert_eq!(problems(&hole, "fn a_test() {}"), ["0 rows for N7"]);
    let idle = whole.replace(&row(7), "| N7 | x | cannot occur: so it is |\n");
    assert_eq!(problems(&idle, "fn a_test() {}"), ["N7 has neither a test nor a reason"]);
}

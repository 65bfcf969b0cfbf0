//! Every row of the table of tools whose files are read names tests that exist.

use crate::product::root;
use crate::tidy::{is_test, rust_sources};

/// Fewest rows; fewer mean that the table was not found.
const FEWEST: usize = 20;

/// The rows of the table that name no test, or one that does not exist.
fn problems(readme: &str, sources: &str) -> Vec<String> {
    let section = readme.split_once("\n## Tools\n").map_or("", |(_, rest)| rest);
    let section = section.split_once("\n## ").map_or(section, |(section, _)| section);
    let rows: Vec<&str> = section.lines().filter(|line| line.starts_with("| ")).skip(1).collect();
    let mut problems = Vec::new();
    problems.extend((rows.len() < FEWEST).then(|| format!("only {} rows", rows.len())));
    for row in rows {
        let evidence = row.trim_end_matches('|').rsplit('|').next().unwrap_or_default();
        let tests: Vec<&str> = evidence.split('`').skip(1).step_by(2).collect();
        let unknown = tests.iter().filter(|test| !is_test(sources, test));
        problems.extend(unknown.map(|test| format!("`{test}` is no test: {row}")));
        problems.extend(tests.is_empty().then(|| format!("no test: {row}")));
    }
    problems
}

#[test]
fn every_tool_has_a_test() {
    let readme = root().join("stages/depth-flow-import/README.md");
    let readme = std::fs::read_to_string(readme).expect("the table is readable");
    assert_eq!(problems(&readme, &rust_sources()), Vec::<String>::new());
}

#[test]
fn a_tool_without_a_test_is_noticed() {
    let rows = "| a tool | a file | depth | format: `a_test` |\n".repeat(FEWEST);
    let readme =
        |rows: &str| format!("# x\n\n## Tools\n\n| tool | file | read as | test |\n|---|---|---|---|\n{rows}\n## y\n");
    let sources = "#[test]\nfn a_test() {}";
    assert_eq!(problems(&readme(&rows), sources), Vec::<String>::new());
    assert_eq!(problems(&readme(&rows), "fn a_test() {}").len(), FEWEST);
    assert_eq!(problems(&readme(&rows.replacen("`a_test`", "by hand", 1)), sources).len(), 1);
    assert_eq!(problems("# x", sources), ["only 0 rows"]);
}

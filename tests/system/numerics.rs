//! Every known numerical pitfall has a test, or a reason why it cannot occur.

use crate::product::root;
use crate::tidy::{is_test, rust_sources};

const CATALOGUE: &str = "tests/numerics.md";
/// Number of entries in the catalogue.
const DANGERS: usize = 50;
/// Letters in the shortest acceptable reason.
const SHORTEST_REASON: usize = 40;

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
        let unknown = tests.iter().filter(|test| !is_test(sources, test));
        problems.extend(unknown.map(|test| format!("N{number} names `{test}`, which is no test")));
        let reason = evidence.split_once("cannot occur:").map_or("", |(_, reason)| reason.trim());
        if tests.is_empty() && reason.chars().count() < SHORTEST_REASON {
            problems.push(format!("N{number} has neither a test nor a reason"));
        }
    }
    let n_rows = rows.len();
    problems.extend((n_rows > DANGERS).then(|| format!("{n_rows} rows for {DANGERS} dangers")));
    problems
}

#[test]
fn every_numerical_danger_has_a_test_or_a_reason() {
    let catalogue = std::fs::read_to_string(root().join(CATALOGUE)).expect("the catalogue is readable");
    assert_eq!(problems(&catalogue, &rust_sources()), Vec::<String>::new());
}

#[test]
fn a_gap_in_the_catalogue_is_noticed() {
    let row = |number: usize| format!("| N{number} | x | `a_test` |\n");
    let whole: String = (1..=DANGERS).map(row).collect();
    let sources = "#[test]\nfn a_test() {}";
    assert_eq!(problems(&whole, sources), Vec::<String>::new());
    assert_eq!(problems(&whole, "#[test]\nfn another() {}").len(), DANGERS);
    assert_eq!(problems(&whole, "fn a_test() {}").len(), DANGERS);
    let gap = whole.replace(&row(7), "");
    assert_eq!(problems(&gap, sources), ["0 rows for N7"]);
    let empty = whole.replace(&row(7), "| N7 | x | cannot occur: so it is |\n");
    assert_eq!(problems(&empty, sources), ["N7 has neither a test nor a reason"]);
    assert_eq!(problems(&(whole + &row(DANGERS + 1)), sources), ["51 rows for 50 dangers"]);
}

//! House rules that a machine can check.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Text that must not stand in the sources, with the reason. Split so that this file does not contain it.
const FORBIDDEN: [(&str, &str, &str); 6] = [
    ("todo", "!(", "unfinished code"),
    ("unimplemented", "!(", "unfinished code"),
    ("#[ign", "ore", "a test that does not run"),
    ("/wo", "rk/", "a path of somebody's machine"),
    ("../sha", "red/seeds", "a path outside of the project"),
    ("/ro", "ot/", "a path of somebody's machine"),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ lies in the workspace").to_owned()
}

/// Tracked text files with their contents.
fn tracked_files() -> Vec<(String, String)> {
    let output = Command::new("git").args(["ls-files", "-z"]).current_dir(root()).output().expect("git runs");
    let names = String::from_utf8(output.stdout).expect("file names are UTF-8");
    let read = |name: &str| Some((name.to_owned(), std::fs::read_to_string(root().join(name)).ok()?));
    names.split_terminator('\0').filter_map(read).collect()
}

/// Every rule that a file breaks.
fn problems(name: &str, text: &str) -> Vec<String> {
    let breaks = |(head, tail, reason): &(&str, &str, &str)| {
        text.contains(&format!("{head}{tail}")).then(|| format!("{name}: {reason} ({head}{tail})"))
    };
    FORBIDDEN.iter().filter_map(breaks).collect()
}

#[test]
fn sources_keep_the_house_rules() {
    let files = tracked_files();
    assert!(files.len() > 50, "git listed only {} files", files.len());
    let broken: Vec<_> = files.iter().flat_map(|(name, text)| problems(name, text)).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn a_broken_rule_is_noticed() {
    for (head, tail, reason) in FORBIDDEN {
        assert_eq!(problems("x.rs", &format!("fn f() {{ {head}{tail} }}")).len(), 1, "{reason}");
        assert!(problems("x.rs", &format!("fn f() {{ {head} {tail} }}")).is_empty(), "{reason}");
    }
}

/// Whether a test of that name runs: a function under `#[test]`, or one that a list of tests names.
fn is_test(sources: &str, name: &str) -> bool {
    let is_marked = |at: usize| {
        let above = sources[..at].split('\n').rev().skip(1).map(str::trim);
        above.take_while(|line| line.starts_with("#[") || line.starts_with("//")).any(|line| line == "#[test]")
    };
    let function = format!("fn {name}(");
    let is_listed = sources.contains(&format!("(\"{name}\", {name})"));
    sources.match_indices(&function).any(|(at, _)| is_listed || is_marked(at))
}

#[test]
fn a_function_that_no_test_runs_is_noticed() {
    let listed = concat!("fn a() {}\nconst TESTS: [T; 1] = [(\"a", "\", a)];");
    assert!(is_test("#[test]\n/// Text.\nfn a() {}", "a") && is_test("mod m {\n    #[test]\n    fn a() {}", "a"));
    assert!(is_test(listed, "a") && !is_test("#[test]\nfn b() {}\nfn a() {}", "a") && !is_test("#[test]\n", "a"));
}

#[test]
fn every_invariant_names_a_test_that_exists() {
    let architecture = std::fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md is there");
    let sources: String =
        tracked_files().into_iter().filter(|(name, _)| name.ends_with(".rs")).map(|(_, t)| t).collect();
    let rows: Vec<_> = architecture.lines().filter(|line| line.starts_with("| I")).collect();
    assert!(rows.len() >= 10, "the table of invariants has {} rows", rows.len());
    for row in rows {
        let tests: Vec<_> = row.split('`').skip(1).step_by(2).filter(|word| word.contains('_')).collect();
        assert!(!tests.is_empty(), "an invariant without a test: {row}");
        for test in tests {
            assert!(is_test(&sources, test), "no test {test}, named by: {row}");
        }
    }
}

#[test]
fn no_file_is_larger_than_half_a_mebibyte() {
    for (name, text) in tracked_files() {
        assert!(text.len() <= 512 * 1024, "{name} has {} bytes", text.len());
    }
}

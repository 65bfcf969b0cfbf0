//! Rules of the sources that a machine can check.

use std::process::Command;

use crate::product::root;

/// Text that must not occur in any tracked file, with the reason. Split so that this file does not contain it.
const FORBIDDEN: [(&str, &str, &str); 6] = [
    ("todo", "!(", "unfinished code"),
    ("unimplemented", "!(", "unfinished code"),
    ("#[ign", "ore", "a test that does not run"),
    ("/wo", "rk/", "a path of one machine"),
    ("../sha", "red/seeds", "a path outside of the project"),
    ("/ro", "ot/", "a path of one machine"),
];

/// Largest size of a tracked text file.
const MAX_BYTES: usize = 512 * 1024;

/// Tracked text files: path relative to the root, and content.
pub(crate) fn tracked_files() -> Vec<(String, String)> {
    let output = Command::new("git").args(["ls-files", "-z"]).current_dir(root()).output().expect("git runs");
    let names = String::from_utf8(output.stdout).expect("file names are UTF-8");
    let read = |name: &str| Some((name.to_owned(), std::fs::read_to_string(root().join(name)).ok()?));
    let files: Vec<_> = names.split_terminator('\0').filter_map(read).collect();
    assert!(files.len() > 500, "git listed only {} files", files.len());
    files
}

/// Every rule that a file breaks.
fn problems(name: &str, text: &str) -> Vec<String> {
    let breaks = |(head, tail, reason): &(&str, &str, &str)| {
        text.contains(&format!("{head}{tail}")).then(|| format!("{name}: {reason} ({head}{tail})"))
    };
    let size = (text.len() > MAX_BYTES).then(|| format!("{name}: {} bytes", text.len()));
    FORBIDDEN.iter().filter_map(breaks).chain(size).chain(repeated_sections(name, text)).collect()
}

/// The headings of sections that a page has twice, which a merge can leave behind. The sections of the changelog repeat.
fn repeated_sections(name: &str, text: &str) -> Vec<String> {
    let is_page = name.ends_with(".md") && name != "CHANGELOG.md";
    let mut seen = std::collections::BTreeSet::new();
    let headings = text.lines().filter(|line| is_page && line.starts_with("## "));
    headings.filter(|line| !seen.insert(*line)).map(|line| format!("{name}: a second section \"{line}\"")).collect()
}

#[test]
fn sources_keep_the_house_rules() {
    let broken: Vec<_> = tracked_files().iter().flat_map(|(name, text)| problems(name, text)).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn a_broken_rule_is_noticed() {
    for (head, tail, reason) in FORBIDDEN {
        assert_eq!(problems("x.rs", &format!("fn f() {{ {head}{tail} }}")).len(), 1, "{reason}");
        assert!(problems("x.rs", &format!("fn f() {{ {head} {tail} }}")).is_empty(), "{reason}");
    }
    assert_eq!(problems("x.rs", &"x".repeat(MAX_BYTES + 1)).len(), 1);
    assert!(problems("x.rs", &"x".repeat(MAX_BYTES)).is_empty());
    let twice = "# A\n## B\n## C\n## B\n";
    assert_eq!(problems("x.md", twice), ["x.md: a second section \"## B\""]);
    assert!(problems("CHANGELOG.md", twice).is_empty() && problems("x.rs", twice).is_empty());
}

/// Whether a test of that name runs: a function under `#[test]`, or one in a list of tests.
pub(crate) fn is_test(sources: &str, name: &str) -> bool {
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

/// All Rust sources of the project, one after the other.
pub(crate) fn rust_sources() -> String {
    tracked_files().into_iter().filter(|(name, _)| name.ends_with(".rs")).map(|(_, text)| text).collect()
}

/// The invariants of a page: number → names of the tests in its list. An invariant is a heading `### I3. …` above a
/// list whose items begin with a test's name in backticks.
fn invariants(page: &str) -> Vec<(usize, Vec<&str>)> {
    let mut found: Vec<(usize, Vec<&str>)> = Vec::new();
    for line in page.lines() {
        if let Some(number) = line.strip_prefix("### I").and_then(|rest| rest.split_once('.')?.0.parse().ok()) {
            found.push((number, Vec::new()));
        } else if line.starts_with('#') && found.last().is_some_and(|(number, _)| *number > 0) {
            found.push((0, Vec::new()));
        } else if let (Some((_, tests)), Some(rest)) = (found.last_mut(), line.strip_prefix("* `")) {
            tests.extend(rest.split_once('`').map(|(name, _)| name));
        }
    }
    found.retain(|(number, _)| *number > 0);
    found
}

/// What is wrong with the invariants of a page, given the sources.
fn invariant_problems(page: &str, sources: &str) -> Vec<String> {
    let invariants = invariants(page);
    let mut problems = Vec::new();
    for (index, (number, tests)) in invariants.iter().enumerate() {
        if *number != index + 1 {
            problems.push(format!("I{number} follows I{index}"));
        }
        if tests.is_empty() {
            problems.push(format!("I{number} names no test"));
        }
        let unknown = tests.iter().filter(|test| !is_test(sources, test));
        problems.extend(unknown.map(|test| format!("I{number} names `{test}`, which is no test")));
        let earlier = invariants[..index].iter().flat_map(|(_, tests)| tests);
        let repeated = earlier.filter(|test| tests.contains(test));
        problems.extend(repeated.map(|test| format!("I{number} repeats `{test}`")));
    }
    problems
}

#[test]
fn every_invariant_names_tests_that_exist() {
    let page = std::fs::read_to_string(root().join("tests/README.md")).expect("tests/README.md is readable");
    assert_eq!(invariants(&page).len(), 21);
    assert_eq!(invariant_problems(&page, &rust_sources()), Vec::<String>::new());
}

#[test]
fn a_wrong_invariant_is_noticed() {
    let sources = "#[test]\nfn a() {}\n#[test]\nfn b() {}\nfn c() {}";
    let page =
        |first: &str, second: &str| format!("### I1. One\n\nText.\n\n* `{first}`\n\n### I2. Two\n* `{second}`: x\n");
    assert_eq!(invariant_problems(&page("a", "b"), sources), Vec::<String>::new());
    assert_eq!(invariant_problems(&page("a", "c"), sources), ["I2 names `c`, which is no test"]);
    assert_eq!(invariant_problems(&page("a", "a"), sources), ["I2 repeats `a`"]);
    assert_eq!(invariant_problems("### I1. One\n\n## Other\n* `a`\n", sources), ["I1 names no test"]);
    assert_eq!(invariant_problems("### I2. One\n* `a`\n", sources), ["I2 follows I0"]);
}

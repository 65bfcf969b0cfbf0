//! Kernels that only one method uses.
//!
//! A training job leaves the kernels of other methods out of its fingerprint: each method names its own. That is right only if
//! nothing else uses them, so the users of every kernel are derived here from the sources.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::json;

use crate::readings::tokens;
use crate::sources::{ScannedCrate, Sources, read};

/// A kernel: a folder below a folder of `shaders/src`.
type Kernel = (String, String);

/// The code that may use a kernel.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum User {
    Kernel(Kernel),
    Method(String),
    /// Code that several methods or stages run.
    Shared,
}

/// The part of the program to which a file belongs.
fn user(name: &str, file: &str, kernels: &BTreeSet<Kernel>) -> User {
    let parts: Vec<&str> = file.split('/').collect();
    match (name, &parts[..]) {
        ("shaders", ["src", group, kernel, _, ..]) => {
            let kernel = (group.to_string(), kernel.to_string());
            if kernels.contains(&kernel) { User::Kernel(kernel) } else { User::Shared }
        }
        ("training", ["src", "methods", method, _, ..]) => User::Method(method.to_string()),
        _ => User::Shared,
    }
}

/// The source as one text without comments and white space; words that follow each other are separated by a space.
fn compact(file: &str, source: &str) -> String {
    let tokens = match file.ends_with(".rs") {
        true => tokens(source),
        false => source.lines().flat_map(|line| line.split_whitespace().map(str::to_owned)).collect(),
    };
    let mut text = String::new();
    let is_word = |symbol: Option<char>| symbol.is_some_and(|symbol| symbol.is_alphanumeric() || symbol == '_');
    for token in tokens {
        if is_word(text.chars().next_back()) && is_word(token.chars().next()) {
            text.push(' ');
        }
        text += &token;
    }
    text
}

/// Whether `text` contains `part` as whole words.
fn has_word(text: &str, part: &str) -> bool {
    let is_word = |symbol: Option<char>| symbol.is_some_and(|symbol| symbol.is_alphanumeric() || symbol == '_');
    text.match_indices(part)
        .any(|(at, _)| !is_word(text[..at].chars().next_back()) && !is_word(text[at + part.len()..].chars().next()))
}

/// Whether a file may use the kernel: it names the kernel in a path, in a list of imports, or in the path of a file.
/// `in_group` holds for files of the kernel's own group, in which `super` may lead to it.
fn uses(text: &str, (group, kernel): &Kernel, in_group: bool, in_shaders: bool) -> bool {
    let prefixes = [format!("{group}::"), "super::".to_owned()];
    let named = |prefix: &String| {
        let lists = text.match_indices(&format!("{prefix}{{")).any(|(at, _)| {
            let list = &text[at + prefix.len()..];
            has_word(list.split(';').next().unwrap_or_default(), kernel)
        });
        has_word(text, &format!("{prefix}{kernel}")) || lists || text.contains(&format!("{prefix}*"))
    };
    let renamed = has_word(text, &format!("{group} as"));
    prefixes[..1 + usize::from(in_group)].iter().any(named)
        || renamed
        || in_shaders && text.contains(&format!("{kernel}/"))
}

/// The types that a file implements without defining them: code may use such an implementation without naming its file.
fn foreign_impls(source: &str, defined: &str) -> Vec<String> {
    let tokens = tokens(source);
    // Elsewhere `impl` begins a type: `-> impl Iterator`.
    let begins_item = |at: usize| at == 0 || ["}", ";", "]", "unsafe"].contains(&tokens[at - 1].as_str());
    let starts = (0..tokens.len()).filter(|at| tokens[*at] == "impl" && begins_item(*at));
    let implemented = starts.filter_map(|start| {
        let head: Vec<&String> =
            tokens[start + 1..].iter().take_while(|token| !["{", "where", ";"].contains(&token.as_str())).collect();
        let mut depth = 0_i32;
        let mut names = Vec::new();
        for token in head {
            match token.as_str() {
                "<" => depth += 1,
                ">" => depth -= 1,
                "for" if depth == 0 => names.clear(),
                name if depth == 0 && name.chars().all(|symbol| symbol.is_alphanumeric() || symbol == '_') => {
                    names.push(name.to_owned());
                }
                _ => (),
            }
        }
        names.pop()
    });
    let is_foreign =
        |name: &String| !["struct", "enum", "trait"].iter().any(|kind| has_word(defined, &format!("{kind} {name}")));
    implemented.filter(is_foreign).collect()
}

/// The Rust and WGSL files of all crates that count, compacted: crate, file, text.
fn texts(crates: &BTreeMap<String, ScannedCrate>) -> Vec<(String, String, String)> {
    let of_crate = |scanned: &ScannedCrate| {
        let files = scanned.files.keys().filter(|file| file.ends_with(".rs") || file.ends_with(".wgsl"));
        let text = |file: &String| (scanned.name.clone(), file.clone(), compact(file, &read(&scanned.root.join(file))));
        files.map(text).collect::<Vec<_>>()
    };
    crates.values().flat_map(of_crate).collect()
}

/// Every kernel folder.
fn kernels(shaders: &ScannedCrate) -> BTreeSet<Kernel> {
    let parts = shaders.files.keys().map(|file| file.split('/').collect::<Vec<_>>());
    parts.filter(|parts| parts.len() > 3).map(|parts| (parts[1].to_owned(), parts[2].to_owned())).collect()
}

/// The direct and indirect users of every kernel, apart from other kernels.
fn users(texts: &[(String, String, String)], kernels: &BTreeSet<Kernel>) -> BTreeMap<Kernel, BTreeSet<User>> {
    let direct = |kernel: &Kernel| {
        let folder = format!("src/{}/{}/", kernel.0, kernel.1);
        let group = format!("src/{}/", kernel.0);
        let others = texts.iter().filter(|(name, file, _)| name != "shaders" || !file.starts_with(&folder));
        let using = others.filter(|(name, file, text)| {
            let in_shaders = name == "shaders";
            uses(text, kernel, in_shaders && file.starts_with(&group), in_shaders)
        });
        using.map(|(name, file, _)| user(name, file, kernels)).collect::<BTreeSet<User>>()
    };
    let direct: BTreeMap<&Kernel, BTreeSet<User>> = kernels.iter().map(|kernel| (kernel, direct(kernel))).collect();
    let all = |kernel: &Kernel| {
        let (mut open, mut seen, mut found) = (vec![kernel.clone()], BTreeSet::new(), BTreeSet::new());
        while let Some(kernel) = open.pop() {
            if !seen.insert(kernel.clone()) {
                continue;
            }
            for user in &direct[&kernel] {
                match user {
                    User::Kernel(kernel) => open.push(kernel.clone()),
                    other => drop(found.insert(other.clone())),
                }
            }
        }
        found
    };
    kernels.iter().map(|kernel| (kernel.clone(), all(kernel))).collect()
}

/// The method that alone uses a kernel, by the kernel's folder.
fn private_kernels(crates: &BTreeMap<String, ScannedCrate>) -> BTreeMap<String, String> {
    let kernels = kernels(&crates["shaders"]);
    let users = users(&texts(crates), &kernels);
    let private = users.into_iter().filter_map(|((group, kernel), users)| {
        match users.into_iter().collect::<Vec<_>>().as_slice() {
            [User::Method(method)] => Some((format!("src/{group}/{kernel}"), method.clone())),
            _ => None,
        }
    });
    private.collect()
}

#[test]
fn methods_name_exactly_the_kernels_that_only_they_use() {
    let sources = Sources::copy();
    let crates = sources.scan();
    let private = private_kernels(&crates);
    assert!(private.len() >= 5, "{private:?}");
    let stages = cli::stages_of(sources.code());
    let training = stages.get("training").expect("a stage");
    for method in training.values("method").expect("training lists its methods") {
        let params = training.canonical_params(&json!({ "method": method })).expect("the defaults are valid");
        let declared: BTreeSet<String> =
            training.unused_sources(&params).expect("canonical")["shaders"].iter().cloned().collect();
        let of_others = private.iter().filter(|(_, user)| **user != method).map(|(kernel, _)| kernel.clone());
        assert_eq!(declared, of_others.collect(), "kernels that {method} does not use");
    }
    for kernel in private.keys() {
        let files = || {
            crates["shaders"]
                .files
                .keys()
                .filter(|file| file.starts_with(&format!("{kernel}/")) && file.ends_with(".rs"))
        };
        let source = |file: &String| read(&crates["shaders"].root.join(file));
        let defined: String = files().map(|file| compact(file, &source(file))).collect();
        let foreign: Vec<String> = files().flat_map(|file| foreign_impls(&source(file), &defined)).collect();
        assert!(foreign.is_empty(), "{kernel} implements {foreign:?}");
    }
}

#[test]
fn every_way_to_use_a_kernel_is_noticed() {
    let kernel = ("losses".to_owned(), "histogram".to_owned());
    let used = |source: &str| uses(&compact("a.rs", source), &kernel, false, false);
    for source in [
        "use shaders::losses::histogram::soft_histogram;",
        "use shaders::losses::{l1, histogram};",
        "use shaders::{losses::{l1::{a, b}, histogram::c}, tape};",
        "use shaders::losses::*;",
        "use shaders::losses as distances;",
        "fn f() { losses::histogram::g() }",
    ] {
        assert!(used(source), "{source}");
    }
    for source in
        ["use shaders::losses::l1;", "// losses::histogram", "fn histogram() {}", "use crate::losses::histograms;"]
    {
        assert!(!used(source), "{source}");
    }
    let sibling = compact("b.rs", "use super::histogram::bins;");
    assert!(uses(&sibling, &kernel, true, true) && !uses(&sibling, &kernel, false, true));
    assert!(uses(&compact("a.wgsl", "#import losses::histogram::bins"), &kernel, false, true));
    assert!(uses(&compact("a.rs", "const T: &str = include_str!(\"../histogram/bins.wgsl\");"), &kernel, false, true));

    let text = |name: &str, file: &str, source: &str| (name.to_owned(), file.to_owned(), compact(file, source));
    let kernels = BTreeSet::from([kernel.clone(), ("losses".to_owned(), "l1".to_owned())]);
    let through = [
        text("shaders", "src/losses/l1/mod.rs", "use super::histogram;"),
        text("training", "src/methods/mcgs/mod.rs", "use shaders::losses::histogram;"),
        text("training", "src/methods/scgs/mod.rs", "use shaders::losses::l1;"),
    ];
    let methods = ["mcgs", "scgs"].map(|name| User::Method(name.into()));
    assert_eq!(users(&through, &kernels)[&kernel], BTreeSet::from(methods.clone()));
    let shared = [through.as_slice(), &[text("rendering", "src/run.rs", "use shaders::losses::l1;")]].concat();
    assert_eq!(users(&shared, &kernels)[&kernel], methods.into_iter().chain([User::Shared]).collect());

    let own = "struct A; impl A { fn f() -> impl Iterator<Item = B> {} } impl<T: X> Op<T> for A {}";
    assert_eq!(foreign_impls(own, "struct A;"), Vec::<String>::new());
    assert_eq!(foreign_impls("impl<T: X> Tape<T> { fn f() {} } impl Op for B {}", "struct A;"), ["Tape", "B"]);
}

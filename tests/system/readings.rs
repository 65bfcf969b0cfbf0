//! Crates that declare `reads-artifacts-of` use nothing but the artifact types of the named crates.
//!
//! `package.metadata.pipeline.reads-artifacts-of` leaves all files of the named crates except `src/artifact.rs`,
//! `src/artifact/` and `src/lib.rs` out of the reader's fingerprint. That is correct only if the reader uses nothing
//! else of those crates, and these files use nothing else of their crate.

use std::collections::BTreeSet;

use proc_macro2::{Delimiter, TokenStream, TokenTree};

use crate::sources::{ScannedCrate, Sources, read, tokens::rust_tokens};

/// Workspace crates that an artifact's type may use, because every reader depends on them too.
const VOCABULARY: [&str; 2] = ["engine", "scene"];

/// The tokens of Rust source without comments and tests. Each bracket is one token.
pub(crate) fn tokens(source: &str) -> Vec<String> {
    let kept = rust_tokens(source).expect("the sources are Rust");
    let mut found = Vec::new();
    flatten(kept.parse().expect("the kept tokens are Rust"), &mut found);
    found
}

fn flatten(stream: TokenStream, found: &mut Vec<String>) {
    for token in stream {
        let TokenTree::Group(group) = token else {
            found.push(token.to_string());
            continue;
        };
        let (open, close) = match group.delimiter() {
            Delimiter::Parenthesis => ("(", ")"),
            Delimiter::Brace => ("{", "}"),
            Delimiter::Bracket => ("[", "]"),
            Delimiter::None => ("", ""),
        };
        found.push(open.into());
        flatten(group.stream(), found);
        found.push(close.into());
    }
}

/// For each path that begins with `name::`, the segment after it, or all segments of a braced list.
fn paths_below(name: &str, tokens: &[String]) -> Vec<String> {
    let begins = |at: &usize| tokens[*at] == name && tokens[at + 1..].starts_with(&[":".into(), ":".into()]);
    let mut found = Vec::new();
    for at in (0..tokens.len()).filter(begins) {
        let rest = &tokens[at + 3..];
        if rest[0] == "{" {
            let list = rest.iter().skip(1).take_while(|token| *token != "}").filter(|token| *token != ",");
            found.extend(list.cloned());
        } else {
            found.push(rest[0].clone());
        }
    }
    found
}

/// The paths that an artifact's file uses beyond itself, the vocabulary and external crates.
fn strange_uses(source: &str, workspace: &BTreeSet<String>) -> Vec<String> {
    let tokens = tokens(source);
    let inside = ["crate", "super"].map(str::to_owned);
    let strangers =
        workspace.iter().filter(|name| !VOCABULARY.contains(&name.as_str())).map(|name| name.replace('-', "_"));
    strangers
        .chain(inside)
        .flat_map(|name| paths_below(&name, &tokens).into_iter().map(move |path| format!("{name}::{path}")))
        .collect()
}

/// The names that a reader uses of the crate `of` beyond its artifact types.
fn strange_readings(source: &str, of: &str, exported: &[String]) -> Vec<String> {
    let used = paths_below(&of.replace('-', "_"), &tokens(source));
    used.into_iter().filter(|name| name != "artifact" && !exported.contains(name)).collect()
}

/// The artifact types that a file adds implementations to.
fn extended_types(source: &str, exported: &[String]) -> Vec<String> {
    let tokens = tokens(source);
    let after = |pair: &[String]| ["impl", "for"].contains(&&*pair[0]) && exported.contains(&pair[1]);
    tokens.windows(2).filter(|pair| after(pair)).map(|pair| pair[1].clone()).collect()
}

fn is_of_the_artifact(file: &str) -> bool {
    file == "src/artifact.rs" || file.starts_with("src/artifact/")
}

/// Every reason why leaving the rest of the crate `of` out of the fingerprint of `reader` is wrong.
fn problems(reader: &ScannedCrate, of: &ScannedCrate, workspace: &BTreeSet<String>) -> Vec<String> {
    let exported = paths_below("artifact", &tokens(&read(&of.root.join("src/lib.rs"))));
    assert!(!exported.is_empty(), "{} exports no artifact", of.name);
    let missing = VOCABULARY.iter().filter(|name| !reader.dependencies.contains(**name));
    let mut problems: Vec<String> = missing.map(|name| format!("{} does not depend on {name}", reader.name)).collect();
    for (file, source) in rust_files(reader) {
        let found = strange_readings(&source, &of.name, &exported);
        problems.extend(found.iter().map(|name| format!("{} {file} uses {}::{name}", reader.name, of.name)));
    }
    for (file, source) in rust_files(of) {
        let found = match is_of_the_artifact(file) {
            true => strange_uses(&source, workspace),
            false => extended_types(&source, &exported),
        };
        problems.extend(found.iter().map(|name| format!("{} {file}: {name}", of.name)));
    }
    problems
}

fn rust_files(scanned: &ScannedCrate) -> impl Iterator<Item = (&String, String)> {
    let files = scanned.files.keys().filter(|file| file.ends_with(".rs"));
    files.map(|file| (file, read(&scanned.root.join(file))))
}

#[test]
fn readers_of_artifacts_use_nothing_else() {
    let sources = Sources::copy();
    let crates = sources.scan();
    let workspace: BTreeSet<String> = crates.keys().cloned().collect();
    let mut readings = 0;
    for reader in crates.values() {
        for of in &reader.reads_artifacts_of {
            readings += 1;
            assert_eq!(problems(reader, &crates[of], &workspace), Vec::<String>::new());
        }
    }
    assert!(readings >= 2, "{readings} readings");
}

#[test]
fn uses_of_more_than_an_artifact_are_noticed() {
    let workspace = BTreeSet::from(["scene".into(), "shaders".into(), "training".into()]);
    let artifact = "use scene::Split;\npub(crate) struct A;\nuse crate::run::{x, y};\nfn f() -> shaders::tape::T {}";
    assert_eq!(strange_uses(artifact, &workspace), ["shaders::tape", "crate::run"]);
    assert!(strange_uses("#[cfg(test)] mod tests { use super::*; }", &workspace).is_empty());

    let exported = ["Model".to_owned(), "ModelHeader".to_owned()];
    let reader = "use training::{Model, ModelHeader}; fn f() { training::player::play(); training::artifact::g(); }";
    assert_eq!(strange_readings(reader, "training", &exported), ["player"]);
    assert_eq!(extended_types("impl Model { fn f() {} } impl Other for ModelHeader {}", &exported).len(), 2);
    assert!(extended_types("fn f(model: Model) {}", &exported).is_empty());
}

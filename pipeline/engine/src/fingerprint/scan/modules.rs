//! Finds the files that only the tests of a crate contain: modules declared as `#[cfg(test)] mod name;`.
//!
//! A file is left out only if such a declaration covers it and no file that counts refers to it: by `mod name;`, or by
//! a string that is its path (`#[path]`, `include!`, `include_str!`).

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

use proc_macro2::{TokenStream, TokenTree};

use super::tokens::{attribute, compact, end_of_ignored, is_ident, is_punct};

/// The files that one file refers to, relative to the crate.
#[derive(Default)]
pub(super) struct References {
    /// Files and folders of modules that exist in tests only.
    test_modules: BTreeSet<PathBuf>,
    /// Files that code outside tests may contain.
    used: BTreeSet<PathBuf>,
}

impl References {
    /// Reads the Rust file at `path`, which is relative to the crate.
    pub(super) fn of(path: &Path, source: &str) -> Result<Self, Box<dyn std::error::Error>> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let stem = path.file_stem().unwrap_or_default();
        let is_root = ["mod", "lib", "main", "build"].iter().any(|name| stem == *name);
        let modules = if is_root { folder.to_owned() } else { folder.join(stem) };
        let mut found = Self::default();
        found.walk(source.parse()?, folder, &modules);
        Ok(found)
    }

    /// Reads the tokens of a file in `folder`; its modules are in `modules`.
    fn walk(&mut self, stream: TokenStream, folder: &Path, modules: &Path) {
        let tokens: Vec<TokenTree> = stream.into_iter().collect();
        let mut at = 0;
        while at < tokens.len() {
            if let Some(declared) = Declaration::at(&tokens, at) {
                at = declared.end;
                self.add(declared, folder, modules);
                continue;
            }
            if let Some(end) = end_of_ignored(&tokens, at) {
                at = end;
                continue;
            }
            match &tokens[at] {
                TokenTree::Group(group) => self.walk(group.stream(), folder, modules),
                TokenTree::Literal(literal) => self.add_text(&literal.to_string(), folder, modules),
                _ => (),
            }
            at += 1;
        }
    }

    fn add(&mut self, declared: Declaration, folder: &Path, modules: &Path) {
        let Declaration { name, path, in_tests, body, .. } = declared;
        if let Some(body) = body {
            if !in_tests {
                self.walk(body, folder, &modules.join(name));
            }
            return;
        }
        let module = modules.join(&name);
        let files = match path {
            Some(path) => vec![plain(&folder.join(&path)), plain(&modules.join(&path))],
            None => vec![modules.join(format!("{name}.rs")), module.join("mod.rs")],
        };
        if in_tests {
            self.test_modules.extend(files.into_iter().chain([module]));
        } else {
            self.used.extend(files);
        }
    }

    /// Records a string as a path, relative to each folder that it may refer to.
    fn add_text(&mut self, literal: &str, folder: &Path, modules: &Path) {
        let Some((_, text)) = literal.trim_end_matches('#').split_once('"') else { return };
        let text = text.trim_end_matches('"').trim_start_matches('/');
        self.used.extend([folder, modules, Path::new("")].map(|base| plain(&base.join(text))));
    }
}

/// A module declaration: `mod name;` or `mod name { … }` with its attributes.
struct Declaration {
    name: String,
    /// The value of `#[path = "…"]`.
    path: Option<String>,
    in_tests: bool,
    /// The content of an inline module.
    body: Option<TokenStream>,
    /// The index of the first token after the declaration.
    end: usize,
}

impl Declaration {
    fn at(tokens: &[TokenTree], start: usize) -> Option<Self> {
        let (mut at, mut path, mut in_tests) = (start, None, false);
        while let Some((end, attribute)) = attribute(tokens, at) {
            let is_inner = is_punct(tokens.get(at + 1), '!');
            let text = compact(attribute);
            in_tests |= !is_inner && text == "cfg(test)";
            path = text.strip_prefix("path=\"").and_then(|text| text.strip_suffix('"')).map(str::to_owned).or(path);
            at = end;
        }
        if is_ident(tokens.get(at), &["pub"]) {
            at += 1;
            at += usize::from(matches!(tokens.get(at), Some(TokenTree::Group(_))));
        }
        let (true, Some(TokenTree::Ident(name))) = (is_ident(tokens.get(at), &["mod"]), tokens.get(at + 1)) else {
            return None;
        };
        let body = match tokens.get(at + 2)? {
            TokenTree::Group(group) => Some(group.stream()),
            token => is_punct(Some(token), ';').then_some(None)?,
        };
        Some(Self { name: name.to_string(), path, in_tests, body, end: at + 3 })
    }
}

/// The path without `.` and `..`.
fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => drop(plain.pop()),
            Component::Normal(name) => plain.push(name),
            Component::CurDir | Component::RootDir | Component::Prefix(_) => (),
        }
    }
    plain
}

/// The files among `paths` that only tests contain. `references` holds what each Rust file refers to.
pub(super) fn test_only<'a>(
    references: &BTreeMap<String, References>,
    paths: impl Iterator<Item = &'a String>,
) -> BTreeSet<String> {
    let test_modules: BTreeSet<&PathBuf> = references.values().flat_map(|file| &file.test_modules).collect();
    let is_of_tests =
        |path: &&String| Path::new(path.as_str()).ancestors().any(|at| test_modules.contains(&at.to_owned()));
    let mut left_out: BTreeSet<String> = paths.filter(is_of_tests).cloned().collect();
    loop {
        // A file that is left out keeps no other file.
        let counted = references.iter().filter(|(path, _)| !left_out.contains(*path)).map(|(_, file)| file);
        let used: BTreeSet<&PathBuf> = counted.flat_map(|file| &file.used).collect();
        let n_before = left_out.len();
        left_out.retain(|path| !used.contains(&PathBuf::from(path.as_str())));
        if left_out.len() == n_before {
            return left_out;
        }
    }
}

//! Which modules of a crate import which, read from its sources, and the cycles among them.
//!
//! The rule: for every module, the imports among its children form an acyclic graph. A use of anything below a sibling
//! counts as a use of that sibling, even through re-exports. Uses between a module and its own ancestors or
//! descendants do not count: a parent may use its children, and a child the items of its parent's own file.
//!
//! Test code (`#[cfg(test)]`) is ignored, and so are paths that begin with neither `crate`, `super`, `self` nor the
//! name of a child module: those lead to other crates.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use proc_macro2::{Delimiter, TokenStream, TokenTree};

use crate::sources::tokens::rust_tokens;

/// The names that lead from the crate's root to a module or an item.
type Names = Vec<String>;

/// Re-exports that are followed before a path counts as unresolvable.
const MAX_DEPTH: usize = 16;

/// One file.
#[derive(Default)]
struct Module {
    children: BTreeSet<String>,
    /// Items that the file defines.
    items: BTreeSet<String>,
    /// What the file's `use` declarations bring in: local name → absolute path.
    uses: BTreeMap<String, Names>,
    /// Absolute paths of `use path::*`.
    globs: Vec<Names>,
    /// Absolute paths that occur anywhere in the file.
    paths: BTreeSet<Names>,
}

/// The modules of a crate, by the names that lead to each; the root has none.
pub(crate) struct ModuleTree {
    modules: BTreeMap<Names, Module>,
}

impl ModuleTree {
    /// Reads the modules of the crate whose `lib.rs` lies in the folder `source`.
    pub(crate) fn of_crate(source: &Path) -> Self {
        Self::new(&|file| std::fs::read_to_string(source.join(file)).ok())
    }

    /// Reads `lib.rs` and all modules that it declares; `text` returns a file's content by its path.
    fn new(text: &dyn Fn(&str) -> Option<String>) -> Self {
        let mut modules = BTreeMap::new();
        let mut open: Vec<Names> = vec![Vec::new()];
        while let Some(names) = open.pop() {
            let folder = names.join("/");
            let files = match names.len() {
                0 => vec!["lib.rs".to_owned()],
                _ => vec![format!("{folder}.rs"), format!("{folder}/mod.rs")],
            };
            // A module in a file that a `#[path]` names is not followed.
            let Some(source) = files.iter().find_map(|file| text(file)) else { continue };
            let kept = rust_tokens(&source).expect("the sources are Rust");
            let tokens: TokenStream = kept.parse().expect("the kept tokens are Rust");
            let mut reader = Reader { at: names.clone(), inside: Vec::new(), depth: 0, module: Module::default() };
            // Twice, because a path may begin with a name that is declared below it.
            reader.read(tokens.clone());
            reader.read(tokens);
            open.extend(reader.module.children.iter().map(|child| joined(&names, child)));
            modules.insert(names, reader.module);
        }
        Self { modules }
    }

    /// The number of modules.
    pub(crate) fn len(&self) -> usize {
        self.modules.len()
    }

    /// The module whose file defines what an absolute path names, through re-exports.
    fn resolve(&self, path: &[String], depth: usize) -> Names {
        let mut at = Names::new();
        for (index, name) in path.iter().enumerate() {
            let Some(module) = self.modules.get(&at) else { break };
            let rest = &path[index + 1..];
            if self.modules.contains_key(&joined(&at, name)) {
                at.push(name.clone());
            } else if depth > MAX_DEPTH || module.items.contains(name) {
                break;
            } else if let Some(target) = module.uses.get(name) {
                return self.resolve(&[target, rest].concat(), depth + 1);
            } else {
                let through = module.globs.iter().map(|glob| self.resolve(glob, depth + 1));
                let source = through.filter(|source| *source != at).find(|source| self.defines(source, name));
                return source.map_or(at, |source| self.resolve(&[&source, &path[index..]].concat(), depth + 1));
            }
        }
        at
    }

    fn defines(&self, module: &Names, name: &String) -> bool {
        let Some(module) = self.modules.get(module) else { return false };
        module.items.contains(name) || module.children.contains(name) || module.uses.contains_key(name)
    }

    /// The imports among siblings: parent → child → sibling → an example of a use (`user → used`).
    fn sibling_imports(&self) -> BTreeMap<Names, BTreeMap<String, BTreeMap<String, String>>> {
        let mut edges: BTreeMap<Names, BTreeMap<String, BTreeMap<String, String>>> = BTreeMap::new();
        for (user, module) in &self.modules {
            for path in &module.paths {
                let used = self.resolve(path, 0);
                let common = user.iter().zip(&used).take_while(|(a, b)| a == b).count();
                if let (Some(from), Some(to)) = (user.get(common), used.get(common)) {
                    let siblings = edges.entry(user[..common].to_vec()).or_default();
                    let example = || format!("{} → {}", user.join("::"), path.join("::"));
                    siblings.entry(from.clone()).or_default().entry(to.clone()).or_insert_with(example);
                }
            }
        }
        edges
    }
}

/// Every cycle of sibling modules, with one import for each step.
pub(crate) fn circles(tree: &ModuleTree) -> Vec<String> {
    let mut found = Vec::new();
    for edges in tree.sibling_imports().values() {
        let mut known = BTreeSet::new();
        for start in edges.keys() {
            if known.contains(start) {
                continue;
            }
            if let Some(steps) = shortest_circle(edges, start) {
                known.extend(steps.windows(2).map(|step| step[0].clone()));
                found.push(
                    steps.windows(2).map(|step| edges[&step[0]][&step[1]].clone()).collect::<Vec<_>>().join("; "),
                );
            }
        }
    }
    found
}

/// The names along the shortest way from `start` back to `start`.
fn shortest_circle(edges: &BTreeMap<String, BTreeMap<String, String>>, start: &String) -> Option<Vec<String>> {
    let mut ways = vec![vec![start.clone()]];
    let mut reached = BTreeSet::new();
    while !ways.is_empty() {
        let mut longer = Vec::new();
        for way in &ways {
            for next in edges.get(way.last()?).into_iter().flat_map(BTreeMap::keys) {
                let way = joined(way, next);
                if next == start {
                    return Some(way);
                }
                if reached.insert(next.clone()) {
                    longer.push(way);
                }
            }
        }
        ways = longer;
    }
    None
}

fn joined(names: &[String], name: &str) -> Names {
    [names, &[name.to_owned()]].concat()
}

/// Reads the tokens of one file.
struct Reader {
    /// The file's module.
    at: Names,
    /// Inline modules around the current token.
    inside: Names,
    /// Brackets around the current token, those of inline modules apart.
    depth: usize,
    module: Module,
}

impl Reader {
    fn read(&mut self, stream: TokenStream) {
        let tokens: Vec<TokenTree> = stream.into_iter().collect();
        let mut index = 0;
        while index < tokens.len() {
            let rest = &tokens[index..];
            index += match word(&rest[0]).as_deref() {
                Some("use") => self.read_use(rest),
                Some("mod") => self.read_module(rest),
                Some("crate" | "super" | "self") => self.read_path(rest),
                Some("fn" | "struct" | "enum" | "trait" | "type" | "const" | "static" | "union" | "macro_rules") => {
                    self.read_item(rest)
                }
                _ => {
                    if let TokenTree::Group(group) = &rest[0] {
                        self.depth += 1;
                        self.read(group.stream());
                        self.depth -= 1;
                    }
                    1
                }
            };
        }
    }

    /// `mod name;` declares a child; `mod name { … }` is a part of this file.
    fn read_module(&mut self, tokens: &[TokenTree]) -> usize {
        let Some(name) = tokens.get(1).and_then(word) else { return 1 };
        match tokens.get(2) {
            Some(TokenTree::Group(body)) => {
                self.module.items.insert(name.clone());
                self.inside.push(name);
                self.read(body.stream());
                self.inside.pop();
                3
            }
            _ => {
                self.module.children.insert(name);
                2
            }
        }
    }

    fn read_item(&mut self, tokens: &[TokenTree]) -> usize {
        if self.depth == 0 {
            // The name follows, after `fn` in `const fn` and after `!` in `macro_rules!`.
            self.module.items.extend(tokens.iter().skip(1).take(2).filter_map(word));
        }
        1
    }

    /// A path in code: `crate::a::b`, up to the first token that is neither a name nor `::`.
    fn read_path(&mut self, tokens: &[TokenTree]) -> usize {
        let mut path: Names = word(&tokens[0]).into_iter().collect();
        let mut index = 1;
        while is_separator(&tokens[index..])
            && let Some(name) = tokens.get(index + 2).and_then(word)
        {
            path.push(name);
            index += 3;
        }
        if path.len() > 1 {
            self.module.paths.extend(self.absolute(&path));
        }
        index
    }

    /// `use` with its tree, up to the semicolon.
    fn read_use(&mut self, tokens: &[TokenTree]) -> usize {
        // `use<'a>` in a bound.
        if tokens.get(1).is_some_and(|token| is_punctuation(token, '<')) {
            return 1;
        }
        let end = tokens.iter().position(|token| is_punctuation(token, ';')).unwrap_or(tokens.len());
        self.read_use_tree(&[], &tokens[1..end]);
        end
    }

    fn read_use_tree(&mut self, prefix: &[String], tokens: &[TokenTree]) {
        let mut path = prefix.to_vec();
        let mut name = None;
        for (index, token) in tokens.iter().enumerate() {
            match token {
                TokenTree::Ident(_) if word(token).as_deref() == Some("as") => {
                    name = tokens.get(index + 1).and_then(word);
                    break;
                }
                TokenTree::Ident(ident) => path.push(ident.to_string()),
                TokenTree::Punct(_) if is_punctuation(token, '*') => {
                    let target = self.absolute(&path);
                    self.module.paths.extend(target.clone());
                    self.module.globs.extend(target);
                    return;
                }
                TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => {
                    let tokens: Vec<TokenTree> = group.stream().into_iter().collect();
                    for tree in tokens.split(|token| is_punctuation(token, ',')) {
                        self.read_use_tree(&path, tree);
                    }
                    return;
                }
                _ => (),
            }
        }
        if path.len() > 1 && path.last().is_some_and(|last| last == "self") {
            path.pop();
        }
        if let (Some(target), Some(last)) = (self.absolute(&path), path.last()) {
            self.module.paths.insert(target.clone());
            // What an inline module brings in is not visible in the file's own module.
            if self.inside.is_empty() {
                self.module.uses.insert(name.unwrap_or_else(|| last.clone()), target);
            }
        }
    }

    /// The path from the crate's root; none for paths into other crates.
    fn absolute(&self, path: &[String]) -> Option<Names> {
        let here = [&self.at[..], &self.inside].concat();
        let ups = path.iter().take_while(|name| *name == "super").count();
        match path.first()?.as_str() {
            "crate" => Some(path[1..].to_vec()),
            "self" => Some([&here, &path[1..]].concat()),
            "super" => Some([&here[..here.len().checked_sub(ups)?], &path[ups..]].concat()),
            first if self.module.children.contains(first) => Some([&self.at, path].concat()),
            first => {
                let target = self.module.uses.get(first)?;
                Some([target, &path[1..]].concat())
            }
        }
    }
}

fn word(token: &TokenTree) -> Option<String> {
    match token {
        TokenTree::Ident(ident) => Some(ident.to_string()),
        _ => None,
    }
}

fn is_punctuation(token: &TokenTree, sign: char) -> bool {
    matches!(token, TokenTree::Punct(punct) if punct.as_char() == sign)
}

/// Whether the tokens begin with `::`.
fn is_separator(tokens: &[TokenTree]) -> bool {
    tokens.len() >= 2 && tokens[..2].iter().all(|token| is_punctuation(token, ':'))
}

/// The cycles of a crate of these files.
fn circles_of(files: &[(&str, &str)]) -> Vec<String> {
    let text = |file: &str| files.iter().find(|(name, _)| *name == file).map(|(_, text)| (*text).to_owned());
    circles(&ModuleTree::new(&text))
}

#[test]
fn a_circle_of_siblings_is_noticed_however_it_is_written() {
    let root = ("lib.rs", "mod a; mod b; pub use b::c::Item;");
    let a = ("a.rs", "fn f() -> crate::b::B { todo() }");
    let empty = ("b/c.rs", "pub struct Item;");
    for b in [
        "mod c; use crate::a::f;",
        "mod c; use super::a;",
        "mod c; use super::{a as x};",
        "mod c; fn g() { super::a::f() }",
    ] {
        let found = circles_of(&[root, a, ("b/mod.rs", b), empty]);
        assert_eq!(found.len(), 1, "{b}: {found:?}");
        assert!(found[0].starts_with("a → b::B; b → a"), "{found:?}");
    }
    // A use by a descendant counts, and so does one through a re-export or a glob.
    let below = [root, a, ("b/mod.rs", "mod c;"), ("b/c.rs", "pub struct Item; use super::super::a::f;")];
    assert_eq!(circles_of(&below), ["a → b::B; b::c → a::f"]);
    let exported = [root, ("a.rs", "use crate::Item;"), ("b/mod.rs", "mod c; use crate::a;"), empty];
    assert_eq!(circles_of(&exported), ["a → Item; b → a"]);
    let glob = [
        ("lib.rs", "mod a; mod b; pub use b::c::*;"),
        ("a.rs", "use crate::Item;"),
        ("b/mod.rs", "pub mod c; mod inner { use super::super::a; }"),
        empty,
    ];
    assert_eq!(circles_of(&glob), ["a → Item; b → a"]);
}

#[test]
fn parents_children_and_tests_make_no_circle() {
    let files = [
        ("lib.rs", "mod a; mod b; pub struct Own; #[cfg(test)] mod tests;"),
        ("a.rs", "use crate::{Own, b::B}; use other::b; #[cfg(test)] mod t { use crate::b; }"),
        ("b/mod.rs", "mod c; use c::C; pub struct B; #[cfg(test)] use crate::a::X;"),
        ("b/c.rs", "use super::B; use crate::Own; mod inner { use super::C; } pub struct C;"),
        ("tests.rs", "use crate::a; use crate::b;"),
    ];
    assert_eq!(circles_of(&files), Vec::<String>::new());
}

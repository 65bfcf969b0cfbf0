use std::collections::BTreeMap;

use naga::valid::Capabilities;

use super::*;
use crate::gpu::layout_tests::validate_text;

/// Values of constants for which [`TYPICAL`] is no valid one.
const TYPICAL_OF: [(&str, u32); 5] =
    [("BATCH", 32), ("DEPTH", 1), ("SH_DEGREE", 3), ("SUBGROUP", 32), ("ITEM_BYTES", 128)];
/// The value of every other constant.
const TYPICAL: u32 = 4;

/// The directives of a file, and the names in its code.
struct Parsed<'a> {
    imports: Vec<&'a str>,
    constants: Vec<&'a str>,
    /// Name → declaration.
    externs: BTreeMap<&'a str, &'a str>,
    /// Names of the file's own functions, types, variables and constants.
    declared: BTreeSet<&'a str>,
    /// Names of parameters, fields and local variables.
    locals: BTreeSet<&'a str>,
    used: BTreeSet<&'a str>,
}

impl<'a> Parsed<'a> {
    fn new(text: &'a str) -> Self {
        let declaration = |extern_: &'a str| (declared_name(extern_).expect("the name of a declaration"), extern_);
        let mut parsed = Self {
            imports: directives(text, "import").collect(),
            constants: directives(text, "const").flat_map(|names| names.split(", ")).collect(),
            externs: directives(text, "extern").map(declaration).collect(),
            declared: text.lines().filter_map(declared_name).collect(),
            locals: BTreeSet::new(),
            used: BTreeSet::new(),
        };
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            parsed.add_words(line.split("//").next().unwrap_or_default());
        }
        parsed
    }

    fn add_words(&mut self, line: &'a str) {
        let mut before = "";
        let mut rest = line;
        while let Some(start) = rest.find(is_of_word) {
            let from = &rest[start..];
            let (word, after) = from.split_at(from.find(|letter| !is_of_word(letter)).unwrap_or(from.len()));
            if after.starts_with(':') || ["let", "var", "const"].contains(&before) {
                self.locals.insert(word);
            } else if !rest[..start].ends_with('.') {
                self.used.insert(word);
            }
            (before, rest) = (word, after);
        }
    }
}

fn is_of_word(letter: char) -> bool {
    letter.is_alphanumeric() || letter == '_'
}

/// The name that a line declares for the whole module, if it does.
fn declared_name(line: &str) -> Option<&str> {
    let line = if line.starts_with("@group") { &line[line.find("var<")?..] } else { line };
    let (kind, rest) = line.split_once(' ')?;
    let declares = ["fn", "struct", "const", "alias"].contains(&kind) || kind.starts_with("var<");
    // The space in `var<storage, read>` is not the one in front of the name.
    let rest = if kind.ends_with(',') { rest.split_once(' ')?.1 } else { rest };
    declares.then(|| rest.split(|letter| !is_of_word(letter)).next())?
}

/// A declaration in place of an extern one; `index` distinguishes bindings.
fn stub(declaration: &str, index: usize) -> String {
    match declaration.split(['<', ' ']).next() {
        Some("fn") => match declaration.split_once("-> ") {
            Some((_, result)) => format!("{declaration} {{ return {result}(); }}\n"),
            None => format!("{declaration} {{}}\n"),
        },
        Some("struct") => format!("{declaration} {{ opaque: u32 }}\n"),
        _ if declaration.starts_with("var<storage") => format!("@group(1) @binding({index}) {declaration};\n"),
        _ => format!("{declaration};\n"),
    }
}

/// Parsed files, by path: a file and everything that it imports.
fn closure(files: Files, path: &'static str) -> BTreeMap<&'static str, Parsed<'static>> {
    let (mut open, mut found) = (vec![path], BTreeMap::new());
    while let Some(path) = open.pop() {
        let parsed = Parsed::new(content(files, path));
        open.extend(parsed.imports.iter().filter(|import| !found.contains_key(*import)));
        found.insert(path, parsed);
    }
    found
}

/// An error if a file lacks a declaration, has one that it does not use, or is invalid.
fn check(files: Files, path: &'static str) -> Result<(), String> {
    let found = closure(files, path);
    let problems = [missing(&found, path), unused(files, &found, path)].concat();
    if !problems.is_empty() {
        return Err(format!("{path}: {}", problems.join(", ")));
    }
    let constants: BTreeSet<&str> = found.values().flat_map(|file| &file.constants).copied().collect();
    let typical = |name: &str| TYPICAL_OF.iter().find(|(other, _)| *other == name).map_or(TYPICAL, |(_, value)| *value);
    let mut text: String = constants.iter().map(|name| format!("const {name}: u32 = {}u;\n", typical(name))).collect();
    let declared: BTreeSet<&str> = found.values().flat_map(|file| &file.declared).copied().collect();
    let externs: BTreeMap<&str, &str> = found.values().flat_map(|file| &file.externs).map(|(a, b)| (*a, *b)).collect();
    for (index, (_, declaration)) in externs.iter().filter(|(name, _)| !declared.contains(*name)).enumerate() {
        text += &stub(declaration, index);
    }
    text += &with_imports(files, content(files, path));
    validate_text(&text, Capabilities::SUBGROUP).map(drop).map_err(|error| format!("{path}: {error}"))
}

/// Names that a file uses and that only the files behind its imports declare.
fn missing(found: &BTreeMap<&str, Parsed>, path: &str) -> Vec<String> {
    let own = &found[path];
    let is_known = |name: &&str| {
        let imported = own.imports.iter().any(|import| found[import].declared.contains(name));
        imported
            || [&own.declared, &own.locals].iter().any(|names| names.contains(name))
            || own.externs.contains_key(name)
    };
    let constants = found.values().flat_map(|file| &file.constants).filter(|name| !own.constants.contains(name));
    let names = found.values().flat_map(|file| &file.declared).chain(constants).filter(|name| !is_known(name));
    let used: BTreeSet<&&str> = names.filter(|name| own.used.contains(*name)).collect();
    used.iter().map(|name| format!("{name:?} is used and not declared")).collect()
}

/// Declarations that a file does not use.
fn unused(files: Files, found: &BTreeMap<&'static str, Parsed<'static>>, path: &str) -> Vec<String> {
    let own = &found[path];
    let names = own.constants.iter().chain(own.externs.keys()).filter(|name| !own.used.contains(*name));
    let imports = own.imports.iter().filter(|import| {
        let (mut wanted, mut offered) = (own.used.clone(), own.declared.clone());
        for other in own.imports.iter().filter(|other| other != import) {
            for file in closure(files, other).values() {
                wanted.extend(file.externs.keys());
                offered.extend(&file.declared);
            }
        }
        let is_called = found[*import].declared.iter().any(|name| wanted.contains(name));
        let calls = closure(files, import).values().any(|file| file.externs.keys().any(|name| offered.contains(name)));
        !is_called && !calls
    });
    names.chain(imports).map(|name| format!("{name:?} is declared and not used")).collect()
}

#[test]
fn every_file_is_valid_on_its_own() {
    let errors: Vec<String> = FILES.iter().filter_map(|(path, _)| check(FILES, path).err()).collect();
    assert!(errors.is_empty(), "{}", errors.join("\n"));
    assert!(FILES.len() > 100, "{} files", FILES.len());
}

/// Terms of a file, which a second one sums.
const SUM: Files = &[
    ("mean", "// Mean.\n#import sum\n#const COUNT // values\nfn term(at: u32) -> f32 { return f32(at + COUNT); }\n"),
    ("one", "const ONE: u32 = 1u;\nfn two() -> u32 { return ONE + ONE; }\n"),
    ("sum", "#import one\n#extern fn term(at: u32) -> f32\nfn sum() -> f32 { return term(0u) + term(ONE); }\n"),
];

/// The error of the file "mean" after a change to one of the files.
fn error_with(path: &str, right: &str, wrong: &str) -> String {
    let changed = |&(name, text): &(&'static str, &'static str)| {
        let text = if name == path { text.replacen(right, wrong, 1).leak() } else { text };
        (name, text)
    };
    let files: Vec<_> = SUM.iter().map(changed).collect();
    assert_ne!(files, SUM, "{right:?} is in the file");
    check(files.leak(), "mean").unwrap_err()
}

#[test]
fn imports_are_assembled_depth_first_and_once() {
    let text = with_imports(SUM, "#import sum\n#import one\n#const COUNT\nfn own() {}\n");
    let names: Vec<&str> = text.lines().filter_map(declared_name).collect();
    assert_eq!(names, ["ONE", "two", "sum", "own"]);
    assert!(!text.contains('#'), "{text}");
    assert_eq!(assemble("fn own() {}", &[("COUNT", 3)]), "const COUNT: u32 = 3u;\nfn own() {}\n");
}

#[test]
#[should_panic(expected = "no WGSL file \"product\"")]
fn an_unknown_import_is_named() {
    with_imports(SUM, "#import product\n");
}

#[test]
fn missing_declarations_are_reported_with_the_file() {
    assert_eq!(check(SUM, "mean"), Ok(()));
    assert_eq!(check(SUM, "sum"), Ok(()));
    assert_eq!(check(SUM, "one"), Ok(()));
    let error = error_with("mean", "at + COUNT", "at + COUNT * FACTOR");
    assert!(error.starts_with("mean: ") && error.contains("FACTOR"), "{error}");
    // Declared by a file that "sum" imports, and by "sum".
    assert_eq!(error_with("mean", "at + COUNT", "at + COUNT + two()"), "mean: \"two\" is used and not declared");
    let other = ("other", "#import mean\nfn other() -> f32 { return term(COUNT); }\n");
    let files: Vec<_> = SUM[..2].iter().chain([&other, &SUM[2]]).copied().collect();
    assert_eq!(check(files.leak(), "other"), Err("other: \"COUNT\" is used and not declared".to_owned()));
    let error = error_with("sum", "#extern fn term(at: u32) -> f32\n", "");
    assert_eq!(error, "mean: \"sum\" is declared and not used");
}

#[test]
fn unused_declarations_are_reported_with_the_file() {
    assert_eq!(error_with("mean", "at + COUNT", "at"), "mean: \"COUNT\" is declared and not used");
    let error = error_with("mean", "#import sum\n", "#import sum\n#import one\n");
    assert_eq!(error, "mean: \"one\" is declared and not used");
    let error = error_with("mean", "#import sum\n", "#import sum\n#extern fn offset() -> f32\n");
    assert_eq!(error, "mean: \"offset\" is declared and not used");
}

//! The project is written in plain technical English: phrases of the dialect that it once used are errors. `STYLE.md`
//! says how to write instead.

use crate::tidy::tracked_files;

/// What may contain the phrases: this list, the style guide that quotes them, and texts that are kept as they were.
const EXEMPT: [&str; 4] = ["tests/system/dialect.rs", "STYLE.md", "CHANGELOG.md", "LICENSE"];

/// Endings of the files that are checked.
const CHECKED: [&str; 4] = [".rs", ".wgsl", ".toml", ".md"];

/// Phrases that must not occur, in lower case, each with what to write instead. They are searched as whole words across
/// line breaks, in comments, texts and identifiers alike (`_` separates words).
const PHRASES: &[(&str, &str)] = &[
    // Idioms that say something else in English.
    ("hang on", "depend on"),
    ("hangs on", "depends on"),
    ("hung on", "depended on"),
    ("in vain", "wasted"),
    ("at rest", "finished, or static"),
    ("goes ahead", "is speculative"),
    ("go ahead", "be speculative"),
    ("went ahead", "was speculative"),
    ("by and by", "gradually"),
    ("all the same", "identical, or anyway"),
    ("the like", "and so on"),
    ("once more", "again"),
    ("for ever", "permanently"),
    ("heed", "absorb"),
    ("heeds", "absorbs"),
    ("aside", "child, or apart"),
    ("anew", "again"),
    ("a slip of", "a mistake"),
    ("of no consequence", "harmless"),
    ("in the words of", "in terms of"),
    ("looks after", "maintains"),
    ("looked at", "read, inspected, checked"),
    ("asked for", "requested"),
    ("for want of", "for lack of"),
    ("to speak of", "noticeable"),
    // People for components.
    ("nobody", "name the component, or use the passive"),
    ("somebody", "name the component, or use the passive"),
    ("anybody", "name the component, or use the passive"),
    ("everybody", "name the component, or use the passive"),
    ("whoever", "name the component"),
    ("whom", "name the component"),
    ("who is", "name the component"),
    ("who has", "name the component"),
    ("tell", "report, print, return, distinguish"),
    ("tells", "reports, prints, returns, distinguishes"),
    ("told", "reported, printed, returned, distinguished"),
    // Quantities.
    ("so many", "N, or this many"),
    ("so long", "this long"),
    ("no figure", "no value"),
    ("figure of", "value of, number of"),
    ("how many there are", "the number of ..."),
    // Presence and absence.
    ("not there", "missing"),
    ("nothing there", "empty"),
    ("what is there", "existing, present"),
    ("that is there", "existing, present"),
    ("that are there", "existing, present"),
    ("if it is there", "if it exists"),
    ("of them there are", "of them are present"),
    ("beside the issue", "irrelevant"),
    // Making and becoming.
    ("made again", "rebuilt, replayed, recomputed"),
    ("make again", "rebuild, replay, recompute"),
    ("makes again", "rebuilds, replays, recomputes"),
    ("make it again", "rebuild, replay, recompute it"),
    ("makes it again", "rebuilds, replays, recomputes it"),
    ("make them again", "rebuild, replay, recompute them"),
    ("makes them again", "rebuilds, replays, recomputes them"),
    ("what becomes of", "the outcome of"),
    ("what became of", "the outcome of"),
    ("what came of", "the outcome of"),
    ("comes to", "results in, amounts to"),
    ("came to", "resulted in, amounted to"),
    ("what stands", "name it"),
    ("what lies", "name it"),
    ("what is known of", "the static facts of"),
    // Capacity and modules.
    ("has room", "has capacity"),
    ("had room", "had capacity"),
    ("too little room", "overflow"),
    ("rooms", "modules"),
];

/// Docstrings that say nothing without their neighbour.
const EMPTY_DOCS: [&str; 9] = [
    "the same.",
    "as above.",
    "as above",
    "by name.",
    "so many.",
    "the others.",
    "the other.",
    "likewise.",
    "see above.",
];

/// One file as words: comment markers gone, one space between words, `_` a space, in lower case.
struct Words {
    text: String,
    /// Where each line begins in `text`.
    lines: Vec<usize>,
}

impl Words {
    fn new(source: &str) -> Self {
        let (mut text, mut lines) = (String::new(), Vec::new());
        for line in source.lines() {
            lines.push(text.len());
            let line = line.trim_start();
            let line = ["//!", "///", "//", "# "].iter().find_map(|marker| line.strip_prefix(marker)).unwrap_or(line);
            for word in line.split(|c: char| c.is_whitespace() || c == '_').filter(|word| !word.is_empty()) {
                text += &word.to_lowercase();
                text.push(' ');
            }
        }
        Self { text, lines }
    }

    /// Line numbers at which `phrase` stands as whole words.
    fn find(&self, phrase: &str) -> Vec<usize> {
        let is_letter = |c: Option<char>| c.is_some_and(char::is_alphanumeric);
        let is_whole = |at: &usize| {
            let (before, after) = (&self.text[..*at], &self.text[at + phrase.len()..]);
            !is_letter(before.chars().next_back()) && !is_letter(after.chars().next())
        };
        let places = self.text.match_indices(phrase).map(|(at, _)| at);
        places.filter(is_whole).map(|at| self.lines.partition_point(|line| *line <= at)).collect()
    }

    /// Line numbers at which `text` stands, whatever is around it.
    fn find_anywhere(&self, text: &str) -> Vec<usize> {
        self.text.match_indices(text).map(|(at, _)| self.lines.partition_point(|line| *line <= at)).collect()
    }
}

/// First lines of docstrings, with their numbers.
fn docs(source: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = source.lines().map(str::trim);
    let before = std::iter::once("").chain(lines.clone());
    let pairs = before.zip(lines).enumerate().filter(|(_, (before, _))| !before.starts_with("//"));
    pairs.filter_map(|(index, (_, line))| {
        let text = line.strip_prefix("/// ").or_else(|| line.strip_prefix("//! "))?;
        Some((index + 1, text))
    })
}

/// Everything in a file that is written in the dialect.
fn problems(name: &str, source: &str) -> Vec<String> {
    let words = Words::new(source);
    let mut found = Vec::new();
    for (phrase, instead) in PHRASES {
        found.extend(words.find(phrase).into_iter().map(|line| format!("{name}:{line}: “{phrase}”: write {instead}")));
    }
    // An example after “as”; a comparison is written “like” or “as in”.
    for quote in [", as `", ", as \"", ", as “"] {
        found.extend(words.find_anywhere(quote).into_iter().map(|line| format!("{name}:{line}: “, as”: write e.g.")));
    }
    for (line, doc) in docs(source) {
        let doc = doc.to_lowercase();
        if EMPTY_DOCS.contains(&&*doc) || doc.starts_with("the same") {
            found.push(format!("{name}:{line}: a docstring that needs its neighbour: {doc}"));
        }
    }
    found
}

#[test]
fn texts_are_plain_technical_english() {
    let is_checked = |name: &str| {
        CHECKED.iter().any(|ending| name.ends_with(ending)) && !EXEMPT.iter().any(|prefix| name.starts_with(prefix))
    };
    let files = tracked_files();
    let found: Vec<String> =
        files.iter().filter(|(name, _)| is_checked(name)).flat_map(|(name, text)| problems(name, text)).collect();
    assert!(found.is_empty(), "{} phrases of the dialect:\n{}", found.len(), found.join("\n"));
}

#[test]
fn every_phrase_of_the_dialect_is_noticed() {
    for (phrase, _) in PHRASES {
        let (first, rest) = phrase.split_once(' ').unwrap_or((phrase, ""));
        let broken = format!("fn f() {{}}\n// It {}\n    /// {rest} it.\n", first.to_uppercase());
        for text in [format!("/// It {phrase}."), format!("fn {}_it() {{}}", phrase.replace(' ', "_")), broken] {
            let found = problems("x.rs", &text);
            assert!(found.iter().any(|line| line.contains(&format!("“{phrase}”"))), "{text}: {found:?}");
        }
        assert_eq!(problems("x.rs", &format!("x{phrase}x")), Vec::<String>::new());
    }
    let line = problems("x.rs", "// one\n\n/// two, somebody\n");
    assert_eq!(line.len(), 1);
    assert!(line[0].starts_with("x.rs:3: "), "{line:?}");
}

#[test]
fn examples_after_as_and_docs_without_content_are_noticed() {
    for text in
        ["/// A time, as `60s`.", "// a time, as\n// \"60s\"", "/// The same.", "//! As above.", "/// The same in B."]
    {
        assert_eq!(problems("x.rs", text).len(), 1, "{text}");
    }
    for text in
        ["/// A time, e.g. `60s`.", "/// Text.\n/// The same text.", "/// Not the same.", "// The same.", "as `x`"]
    {
        assert_eq!(problems("x.rs", text), Vec::<String>::new(), "{text}");
    }
}

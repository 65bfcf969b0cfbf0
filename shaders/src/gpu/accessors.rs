//! Rewrites the text of a kernel so that it accesses arrays through functions: `values[at]` becomes `get_values(at)`, an
//! assignment to it `set_values(at, …)`, `atomicAdd(&values[at], …)` `atomicAdd_values(at, …)`, and `arrayLength(&values)`
//! `len_values()`. Kernels take an element's address in no other way, and give no other identifier the name of an array.

/// Atomic operations that kernels use on arrays, with whether they take a value.
pub(super) const ATOMIC: [(&str, bool); 3] = [("atomicLoad", false), ("atomicAdd", true), ("atomicMax", true)];
/// The operators of compound assignments.
const OPERATORS: [&str; 8] = ["", "+", "-", "*", "/", "&", "|", "^"];

/// An array as a kernel's text declares it.
pub(super) struct DeclaredArray<'a> {
    /// The declaration without its semicolon.
    pub statement: &'a str,
    pub name: &'a str,
    pub element: &'a str,
    pub is_written: bool,
}

impl<'a> DeclaredArray<'a> {
    /// The array at a binding of a text without comments.
    pub(super) fn at(text: &'a str, binding: usize) -> Self {
        let place = format!("@group(0) @binding({binding})");
        let found = text.find(&place).and_then(|start| {
            let statement = text[start..].split(';').next()?;
            let (access, rest) = statement.split_once("var<storage,")?.1.split_once('>')?;
            let (name, kind) = rest.split_once(':')?;
            let element = kind.trim().strip_prefix("array<")?.strip_suffix('>')?;
            Some(Self { statement, name: name.trim(), element, is_written: access.trim() == "read_write" })
        });
        found.unwrap_or_else(|| panic!("no array at binding {binding} of\n{text}"))
    }

    /// 32-bit numbers per element.
    pub(super) fn lanes(&self) -> usize {
        let vectors = [("vec2", 2), ("vec4", 4)];
        vectors.into_iter().find(|(vector, _)| self.element.starts_with(vector)).map_or(1, |(_, lanes)| lanes)
    }
}

pub(super) fn without_comments(text: &str) -> String {
    text.lines().map(|line| line.split("//").next().unwrap_or_default().to_owned() + "\n").collect()
}

/// Rewrites every access to an element of these arrays, and every `arrayLength` of them, as a function call.
pub(super) fn through_functions(text: &str, arrays: &[&str]) -> String {
    let is_among = |name: &str| arrays.contains(&name);
    let mut out = String::new();
    let mut rest = text;
    while let Some(start) = rest.find(is_of_word) {
        let (before, from) = rest.split_at(start);
        let end = from.find(|letter| !is_of_word(letter)).unwrap_or(from.len());
        let (word, after) = from.split_at(end);
        out += before;
        rest = after;
        let addressed =
            after.strip_prefix("(&").map(|inner| inner.split_at(inner.find(|l| !is_of_word(l)).unwrap_or(0)));
        match (addressed, bracketed(after)) {
            (Some((name, after)), _) if word == "arrayLength" && is_among(name) => {
                out += &format!("len_{name}(");
                rest = after;
            }
            (Some((name, after)), _) if ATOMIC.iter().any(|(name, _)| *name == word) && is_among(name) => {
                let (index, after) = bracketed(after).expect("an atomic element");
                out += &format!("{word}_{name}({}", through_functions(index, arrays));
                rest = after;
            }
            (_, Some((index, after))) if is_among(word) && !before.ends_with('.') => {
                let (use_of_element, after) = element_use(word, index, after, arrays);
                out += &use_of_element;
                rest = after;
            }
            _ => out += word,
        }
    }
    out + rest
}

/// The replacement of `name[index]`, including an assignment to it, and the text that follows.
fn element_use<'a>(name: &str, index: &str, after: &'a str, arrays: &[&str]) -> (String, &'a str) {
    let index = through_functions(index, arrays);
    let get = format!("get_{name}({index})");
    let next = after.trim_start();
    let assigned = OPERATORS.iter().find_map(|operator| {
        let value = next.strip_prefix(operator)?.strip_prefix('=')?;
        (!value.starts_with('=')).then_some((*operator, value))
    });
    let Some((operator, value)) = assigned else { return (get, after) };
    let (value, after) = value.split_once(';').expect("an assignment ends");
    let value = through_functions(value, arrays);
    let value = if operator.is_empty() { value } else { format!("{get} {operator} ({value})") };
    (format!("set_{name}({index}, {value});"), after)
}

fn is_of_word(letter: char) -> bool {
    letter.is_alphanumeric() || letter == '_'
}

/// If the text starts with a bracket: its content up to the closing bracket, and the text that follows.
fn bracketed(text: &str) -> Option<(&str, &str)> {
    let inner = text.strip_prefix('[')?;
    let mut depth = 1;
    let end = inner.find(|letter| {
        depth += i32::from(letter == '[') - i32::from(letter == ']');
        depth == 0
    });
    end.map(|end| (&inner[..end], &inner[end + 1..]))
}

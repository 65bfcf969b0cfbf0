//! The text of a kernel whose arrays come in parts: each use of an element becomes a call of a function that selects the
//! part. `values[at]` becomes `get_values(at)`, an assignment to it `set_values(at, …)`, `atomicAdd(&values[at], …)`
//! `atomicAdd_values(at, …)`, and `arrayLength(&values)` `len_values()`. Kernels take an element's address in no other way,
//! and give no other identifier the name of an array; every kernel's test also validates its text in parts.

/// Atomic operations that kernels use on arrays.
const ATOMIC: [&str; 2] = ["atomicAdd", "atomicMax"];
/// The operators of compound assignments.
const OPERATORS: [&str; 8] = ["", "+", "-", "*", "/", "&", "|", "^"];

/// An array that comes in parts, as a kernel's text declares it.
struct SplitArray<'a> {
    name: &'a str,
    element: &'a str,
    is_written: bool,
    count: usize,
    /// Elements of every part but the last.
    len: usize,
}

/// The text for arrays (from binding 1 on) with `counts` parts of `len` 32-bit numbers each. The first part of each array
/// keeps the array's binding, the others follow the last array.
pub(crate) fn in_parts(whole: &str, counts: &[usize], len: usize) -> String {
    let whole = without_comments(whole);
    let mut declared = String::new();
    let mut arrays = Vec::new();
    let mut binding = counts.len() + 1;
    for (index, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 1) {
        let array = SplitArray::declared(&whole, index + 1, count, len);
        declared += &array.declarations(binding);
        binding += count - 1;
        arrays.push(array);
    }
    declared + &rewritten(&whole, &arrays)
}

impl<'a> SplitArray<'a> {
    /// The array at a binding, in parts of this many 32-bit numbers.
    fn declared(text: &'a str, binding: usize, count: usize, numbers: usize) -> Self {
        let place = format!("@binding({binding})");
        let declaration = text.split(';').find(|statement| statement.contains(&place));
        let found = declaration.and_then(|declaration| {
            let (access, rest) = declaration.split_once("var<storage,")?.1.split_once('>')?;
            let (name, kind) = rest.split_once(':')?;
            let element = kind.trim().strip_prefix("array<")?.strip_suffix('>')?;
            let lanes = [("vec2", 2), ("vec4", 4)].into_iter().find(|(vector, _)| element.starts_with(vector));
            let (name, is_written) = (name.trim(), access.trim() == "read_write");
            Some(Self { name, element, is_written, count, len: numbers / lanes.map_or(1, |(_, lanes)| lanes) })
        });
        found.unwrap_or_else(|| panic!("no array at binding {binding} of\n{text}"))
    }

    /// The parts behind the first, from a binding on, and the functions that choose among all parts.
    fn declarations(&self, binding: usize) -> String {
        let Self { name, element, count, len, .. } = self;
        let access = if self.is_written { "read_write" } else { "read" };
        let part = |part: usize| {
            let binding = binding + part - 1;
            format!("@group(0) @binding({binding}) var<storage, {access}> {name}_{part}_part: array<{element}>;\n")
        };
        let (last, before) = (count - 1, (count - 1) * len);
        let length = format!("fn len_{name}() -> u32 {{ return {before}u + arrayLength(&{name}_{last}_part); }}\n");
        (1..*count).map(part).collect::<String>() + &length + &self.functions()
    }

    fn functions(&self) -> String {
        let Self { name, element, .. } = self;
        if element.starts_with("atomic") {
            let function = |operation| {
                let choice = self.choice(&|element| format!("return {operation}(&{element}, value);"));
                format!("fn {operation}_{name}(at: u32, value: u32) -> u32 {{\n{choice}}}\n")
            };
            return ATOMIC.map(function).concat();
        }
        let get = self.choice(&|element| format!("return {element};"));
        let get = format!("fn get_{name}(at: u32) -> {element} {{\n{get}}}\n");
        #[cfg(test)]
        let get = crate::gpu::fault_tests::planted("parts", get);
        if !self.is_written {
            return get;
        }
        let set = self.choice(&|element| format!("{element} = value; return;"));
        get + &format!("fn set_{name}(at: u32, value: {element}) {{\n{set}}}\n")
    }

    /// A chain of branches that runs `statement` for the part that contains `at`.
    fn choice(&self, statement: &dyn Fn(&str) -> String) -> String {
        let Self { name, len, .. } = self;
        let case = |part| {
            let element = format!("{name}_{part}_part[at - {}u]", part * len);
            format!("        case {part}u: {{ {} }}\n", statement(&element))
        };
        let cases: String = (1..self.count).map(case).collect();
        let first = statement(&format!("{name}[at]"));
        format!("    switch at / {len}u {{\n{cases}        default: {{}}\n    }}\n    {first}\n")
    }
}

fn without_comments(text: &str) -> String {
    text.lines().map(|line| line.split("//").next().unwrap_or_default().to_owned() + "\n").collect()
}

/// The text with every use of these arrays' elements and lengths as a call.
fn rewritten(text: &str, arrays: &[SplitArray]) -> String {
    let is_split = |name: &str| arrays.iter().any(|array| array.name == name);
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
            (Some((name, after)), _) if word == "arrayLength" && is_split(name) => {
                out += &format!("len_{name}(");
                rest = after;
            }
            (Some((name, after)), _) if ATOMIC.contains(&word) && is_split(name) => {
                let (index, after) = bracketed(after).expect("an atomic element");
                out += &format!("{word}_{name}({}", rewritten(index, arrays));
                rest = after;
            }
            (_, Some((index, after))) if is_split(word) && !before.ends_with('.') => {
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
fn element_use<'a>(name: &str, index: &str, after: &'a str, arrays: &[SplitArray]) -> (String, &'a str) {
    let index = rewritten(index, arrays);
    let get = format!("get_{name}({index})");
    let next = after.trim_start();
    let assigned = OPERATORS.iter().find_map(|operator| {
        let value = next.strip_prefix(operator)?.strip_prefix('=')?;
        (!value.starts_with('=')).then_some((*operator, value))
    });
    let Some((operator, value)) = assigned else { return (get, after) };
    let (value, after) = value.split_once(';').expect("an assignment ends");
    let value = rewritten(value, arrays);
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

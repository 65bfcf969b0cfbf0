//! The text of a kernel whose arrays come in parts: functions that select the part replace each use of an element.

use crate::gpu::accessors::{ATOMIC, DeclaredArray, through_functions, without_comments};

/// An array that comes in parts.
struct SplitArray<'a> {
    array: DeclaredArray<'a>,
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
    let names: Vec<&str> = arrays.iter().map(|array| array.array.name).collect();
    declared + &through_functions(&whole, &names)
}

impl<'a> SplitArray<'a> {
    /// The array at a binding, in parts of this many 32-bit numbers.
    fn declared(text: &'a str, binding: usize, count: usize, numbers: usize) -> Self {
        let array = DeclaredArray::at(text, binding);
        Self { count, len: numbers / array.lanes(), array }
    }

    /// The parts behind the first, from a binding on, and the functions that choose among all parts.
    fn declarations(&self, binding: usize) -> String {
        let Self { array: DeclaredArray { name, element, is_written, .. }, count, len } = self;
        let access = if *is_written { "read_write" } else { "read" };
        let part = |part: usize| {
            let binding = binding + part - 1;
            format!("@group(0) @binding({binding}) var<storage, {access}> {name}_{part}_part: array<{element}>;\n")
        };
        let (last, before) = (count - 1, (count - 1) * len);
        let length = format!("fn len_{name}() -> u32 {{ return {before}u + arrayLength(&{name}_{last}_part); }}\n");
        (1..*count).map(part).collect::<String>() + &length + &self.functions()
    }

    fn functions(&self) -> String {
        let DeclaredArray { name, element, is_written, .. } = self.array;
        if element.starts_with("atomic") {
            let function = |(operation, takes_value)| {
                let (value, parameter) = if takes_value { (", value", ", value: u32") } else { ("", "") };
                let choice = self.choice(&|element| format!("return {operation}(&{element}{value});"));
                format!("fn {operation}_{name}(at: u32{parameter}) -> u32 {{\n{choice}}}\n")
            };
            return ATOMIC.map(function).concat();
        }
        let get = self.choice(&|element| format!("return {element};"));
        let get = format!("fn get_{name}(at: u32) -> {element} {{\n{get}}}\n");
        #[cfg(test)]
        let get = crate::gpu::fault_tests::planted("parts", get);
        if !is_written {
            return get;
        }
        let set = self.choice(&|element| format!("{element} = value; return;"));
        get + &format!("fn set_{name}(at: u32, value: {element}) {{\n{set}}}\n")
    }

    /// A chain of branches that runs `statement` for the part that contains `at`.
    fn choice(&self, statement: &dyn Fn(&str) -> String) -> String {
        let Self { array: DeclaredArray { name, .. }, len, .. } = self;
        let case = |part| {
            let element = format!("{name}_{part}_part[at - {}u]", part * len);
            format!("        case {part}u: {{ {} }}\n", statement(&element))
        };
        let cases: String = (1..self.count).map(case).collect();
        let first = statement(&format!("{name}[at]"));
        format!("    switch at / {len}u {{\n{cases}        default: {{}}\n    }}\n    {first}\n")
    }
}

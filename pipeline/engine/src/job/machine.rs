//! A description of the machine and the program, which is stored with a job's measured times.

use std::fs;

use serde_json::{Value, json};

use crate::Registry;

/// The processor, its threads, the memory, the operating system, and the sources and compiler of the program. Unknown
/// values are null.
pub(super) fn card(registry: &Registry) -> Value {
    let system = rustix::system::uname();
    let [name, release, architecture] =
        [system.sysname(), system.release(), system.machine()].map(|text| text.to_string_lossy().into_owned());
    json!({
        "cpu": first_value("/proc/cpuinfo", "model name"),
        "hardware_threads": std::thread::available_parallelism().ok().map(usize::from),
        "cores": cores(),
        "memory_bytes": memory_bytes(),
        "system": format!("{name} {release} {architecture}"),
        "program": concat!("pipeline ", env!("CARGO_PKG_VERSION")),
        "sources": registry.sources_digest(),
        "built_with": registry.built_with(),
    })
}

/// The number of physical cores: distinct pairs of socket and core.
fn cores() -> Option<usize> {
    let text = fs::read_to_string("/proc/cpuinfo").ok()?;
    let of = |processor: &str, key: &str| value_of(processor, key);
    let pairs: std::collections::BTreeSet<_> =
        text.split("\n\n").filter_map(|one| Some((of(one, "physical id")?, of(one, "core id")?))).collect();
    (!pairs.is_empty()).then_some(pairs.len())
}

fn memory_bytes() -> Option<u64> {
    let kibibytes = first_value("/proc/meminfo", "MemTotal")?;
    Some(kibibytes.strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}

fn first_value(path: &str, key: &str) -> Option<String> {
    value_of(&fs::read_to_string(path).ok()?, key)
}

/// The value in the first line of the form `key : value`.
fn value_of(text: &str, key: &str) -> Option<String> {
    let pairs = text.lines().filter_map(|line| line.split_once(':'));
    let value = pairs.into_iter().find(|(name, _)| name.trim() == key)?.1.trim();
    (!value.is_empty()).then(|| value.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_found_by_whole_keys() {
        let text = "processor\t: 0\nmodel\t\t: 85\nmodel name\t: A: B\ncore id\t:\n";
        assert_eq!(value_of(text, "model name").as_deref(), Some("A: B"));
        assert_eq!(value_of(text, "model").as_deref(), Some("85"));
        assert_eq!((value_of(text, "core id"), value_of(text, "name")), (None, None));
    }
}

//! The effects that jobs simulate and those that they leave out, with reasons, grouped over jobs with equal decisions.

use std::collections::BTreeMap;

use engine::{Decision, Plan};

/// Jobs of one template with equal decisions.
pub(crate) struct Alike<'a> {
    /// The jobs' names with `*` for the parts that differ, e.g. `train/*/deformable4dgs/0`.
    pub(crate) pattern: String,
    /// The decisions of each job.
    pub(crate) decisions: &'a [Decision],
}

/// Groups the nodes with these indices by template and decisions, in the order of the plan.
pub(crate) fn decided_alike(plan: &Plan, nodes: impl Iterator<Item = usize>) -> Vec<Alike<'_>> {
    let mut groups: Vec<(&str, &[Decision], Vec<&str>)> = Vec::new();
    for node in nodes.map(|index| &plan.nodes[index]).filter(|node| !node.decisions.is_empty()) {
        let known = groups.iter_mut().find(|(template, decisions, _)| {
            *template == node.template && *decisions == node.decisions.as_slice() //
        });
        match known {
            Some((_, _, names)) => names.push(&node.name),
            None => groups.push((&node.template, &node.decisions, vec![&node.name])),
        }
    }
    groups.into_iter().map(|(_, decisions, names)| Alike { pattern: pattern(&names), decisions }).collect()
}

/// Replaces the parts in which the names differ by `*`.
fn pattern(names: &[&str]) -> String {
    let mut parts: Vec<&str> = names[0].split('/').collect();
    for name in names {
        parts
            .iter_mut()
            .zip(name.split('/'))
            .filter(|(part, other)| **part != *other)
            .for_each(|(part, _)| *part = "*");
    }
    parts.join("/")
}

/// One line per group of jobs, and one for the jobs that the plan leaves out.
pub(crate) fn render(plan: &Plan, nodes: impl Iterator<Item = usize>) -> String {
    let mut text = String::new();
    for Alike { pattern, decisions } in decided_alike(plan, nodes) {
        let sentences: Vec<String> = decisions.iter().map(sentence).collect();
        text += &format!("effects of {pattern}: {}\n", sentences.join("; "));
    }
    let mut left_out: BTreeMap<&str, usize> = BTreeMap::new();
    for name in &plan.left_out {
        *left_out.entry(name.split('/').next().unwrap_or_default()).or_default() += 1;
    }
    let counts: Vec<String> = left_out.iter().map(|(template, count)| format!("{count} × {template}")).collect();
    if !counts.is_empty() {
        text += &format!("left out, because no job needs them or they would repeat another: {}\n", counts.join(", "));
    }
    text
}

/// A decision in words, e.g. `flow off (nothing is wired to priors)`.
pub(crate) fn sentence(decision: &Decision) -> String {
    let Decision { effect, on, reason } = decision;
    format!("{effect} {} ({reason})", if *on { "on" } else { "off" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differing_parts_become_stars() {
        assert_eq!(pattern(&["train/ball/a/0"]), "train/ball/a/0");
        assert_eq!(pattern(&["train/ball/a/0", "train/lego/a/1"]), "train/*/a/*");
    }
}

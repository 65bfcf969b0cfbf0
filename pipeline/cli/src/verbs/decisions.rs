//! What jobs simulate and leave out, and why, in few lines.

use std::collections::BTreeMap;

use engine::{Decision, Plan};

/// Jobs of one template that decided alike.
pub struct Alike<'a> {
    /// Their names, with `*` where they differ: `train/*/deformable4dgs/0`.
    pub pattern: String,
    /// What each of them decided.
    pub decisions: &'a [Decision],
}

/// The decisions of the nodes with these indices, in the order of the plan.
pub fn decided_alike(plan: &Plan, nodes: impl Iterator<Item = usize>) -> Vec<Alike<'_>> {
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

/// `train/ball/a/0` and `train/ball/a/1` are `train/ball/a/*`.
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

/// One line per group of jobs, and one for the jobs that nothing needs.
pub fn render(plan: &Plan, nodes: impl Iterator<Item = usize>) -> String {
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
        text += &format!("left out, because no job needs it: {}\n", counts.join(", "));
    }
    text
}

/// `flow off (nothing is wired to priors)`.
pub fn sentence(decision: &Decision) -> String {
    let Decision { effect, on, reason } = decision;
    format!("{effect} {} ({reason})", if *on { "on" } else { "off" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_differs_is_a_star() {
        assert_eq!(pattern(&["train/ball/a/0"]), "train/ball/a/0");
        assert_eq!(pattern(&["train/ball/a/0", "train/lego/a/1"]), "train/*/a/*");
    }
}

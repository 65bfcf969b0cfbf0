//! Selects nodes by patterns of names, e.g. `train`, `train/lego`, `train/*/mcgs*`.

use std::collections::BTreeSet;

use super::Plan;
use crate::suggest::nearest;

/// The error for a pattern that matches no node.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no job matches `{pattern}`{}", advice.as_ref().map(ToString::to_string).unwrap_or_default())]
pub struct NothingSelected {
    /// The pattern.
    pub pattern: String,
    /// What was probably meant, if anything is similar.
    pub advice: Option<Advice>,
}

/// What a pattern without a match probably meant.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Advice {
    /// A job that matches but is left out of the plan.
    #[error("; {0} is left out, because no job needs it or it would repeat another")]
    LeftOut(String),
    /// A job that would match if `*` and `?` also matched slashes.
    #[error("; * and ? do not match a slash: write one * for every part of a name like {0}")]
    Slash(String),
    /// The most similar name.
    #[error("; did you mean `{0}`?")]
    Nearest(String),
}

impl Plan {
    /// The nodes whose names match any of `patterns`; all nodes if there are no patterns. A pattern without a match is
    /// an error.
    pub fn select(&self, patterns: &[String]) -> Result<BTreeSet<usize>, NothingSelected> {
        if patterns.is_empty() {
            return Ok((0..self.nodes.len()).collect());
        }
        let mut selected = BTreeSet::new();
        for pattern in patterns {
            let found: Vec<usize> =
                (0..self.nodes.len()).filter(|&index| matches_pattern(pattern, &self.nodes[index].name)).collect();
            if found.is_empty() {
                return Err(NothingSelected { pattern: pattern.clone(), advice: self.advice(pattern) });
            }
            selected.extend(found);
        }
        Ok(selected)
    }

    /// The advice for a pattern that matches no node.
    fn advice(&self, pattern: &str) -> Option<Advice> {
        let left_out = self.left_out.iter().find(|name| matches_pattern(pattern, name));
        let whole = || self.nodes.iter().map(|node| &node.name).find(|name| matches_part(pattern, name));
        let names = || self.nodes.iter().flat_map(|node| [node.template.as_str(), node.name.as_str()]);
        left_out
            .map(|name| Advice::LeftOut(name.clone()))
            .or_else(|| whole().map(|name| Advice::Slash(name.clone())))
            .or_else(|| nearest(pattern, names()).map(Advice::Nearest))
    }
}

/// Whether the pattern's `/`-separated parts match the first parts of `name`. `*` matches any characters, `?` one.
pub fn matches_pattern(pattern: &str, name: &str) -> bool {
    let mut parts = name.split('/');
    pattern.trim_end_matches('/').split('/').all(|wanted| parts.next().is_some_and(|part| matches_part(wanted, part)))
}

fn matches_part(pattern: &str, text: &str) -> bool {
    let mut rest = pattern.chars();
    match rest.next() {
        None => text.is_empty(),
        // Try every suffix of the text.
        Some('*') => {
            text.char_indices().map(|(at, _)| at).chain([text.len()]).any(|at| matches_part(rest.as_str(), &text[at..]))
        }
        Some(wanted) => {
            let mut text = text.chars();
            text.next()
                .is_some_and(|got| (wanted == '?' || wanted == got) && matches_part(rest.as_str(), text.as_str()))
        }
    }
}

//! Suggestions for misspelt names.

/// Similarity (1 for equal names) below which a candidate is not suggested: such names share a few letters by chance.
const MIN_SIMILARITY: f64 = 0.6;

/// The candidate closest to `wrong`, if any is close enough to suggest.
pub(crate) fn nearest<'a>(wrong: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<String> {
    let wrong = wrong.to_lowercase();
    // A dotted key is compared without its tables if `wrong` has none.
    let own = |name: &str| match wrong.contains('.') {
        true => name.to_lowercase(),
        false => name.rsplit('.').next().unwrap_or(name).to_lowercase(),
    };
    let similarity = |name: &str| strsim::normalized_damerau_levenshtein(&wrong, &own(name));
    let scored = candidates.into_iter().map(|name| (similarity(name), name));
    // The first of equally close names wins, so that the message does not depend on a sort.
    let best = scored.fold(None, |best: Option<(f64, &str)>, next| match best {
        Some(best) if best.0 >= next.0 => Some(best),
        _ => Some(next),
    });
    best.filter(|(similarity, _)| *similarity >= MIN_SIMILARITY).map(|(_, name)| name.into())
}

/// The hint "did you mean `x`? allowed: x, y" for a name that is none of `allowed`.
pub fn names_hint<'a>(wrong: &str, allowed: impl IntoIterator<Item = &'a str>) -> String {
    let allowed: Vec<&str> = allowed.into_iter().collect();
    if allowed.is_empty() {
        return "none is allowed here".into();
    }
    let list = format!("allowed: {}", allowed.join(", "));
    match nearest(wrong, allowed.iter().copied()) {
        Some(name) => format!("did you mean `{name}`? {list}"),
        None => list,
    }
}

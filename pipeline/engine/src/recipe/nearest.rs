//! The name that the user probably meant.

/// The candidate closest to `wrong`, if any is close enough to be worth proposing.
pub(crate) fn nearest<'a>(wrong: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<String> {
    // Below 0.6 (of 1 for equal) proposals are names that share a few letters by chance.
    const LEAST_SIMILARITY: f64 = 0.6;
    let scored = candidates.into_iter().map(|name| (strsim::normalized_damerau_levenshtein(wrong, name), name));
    // Of equally close names the first one wins, so that the message does not depend on the sort.
    let best = scored.fold(None, |best: Option<(f64, &str)>, next| match best {
        Some(best) if best.0 >= next.0 => Some(best),
        _ => Some(next),
    });
    best.filter(|(similarity, _)| *similarity >= LEAST_SIMILARITY).map(|(_, name)| name.into())
}

//! Distinct values in order of appearance.

/// The distinct values in order of appearance, which is the order of the recipe.
pub fn distinct<'a>(values: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut seen = Vec::new();
    for value in values {
        if !seen.iter().any(|other| other == value) {
            seen.push(value.to_owned());
        }
    }
    seen
}

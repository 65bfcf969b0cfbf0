//! How a number looks: the one place that rounds.

/// What stands where there is no number.
pub const NONE: &str = "–";

/// `value` with `decimals` decimals; never `-0.00`, and a dash for what is not finite (which [`crate::Report`] refuses).
pub fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return NONE.into();
    }
    let text = format!("{value:.decimals$}");
    let is_zero = text.chars().all(|c| matches!(c, '-' | '0' | '.'));
    if is_zero { text.trim_start_matches('-').into() } else { text }
}

/// `1 scene`, `2 scenes`.
pub fn scenes(count: usize) -> String {
    format!("{count} scene{}", if count == 1 { "" } else { "s" })
}

/// `value` with a sign, for differences.
pub fn signed(value: f64, decimals: usize) -> String {
    let text = number(value, decimals);
    if text.starts_with('-') { text.replacen('-', "−", 1) } else { format!("+{text}") }
}

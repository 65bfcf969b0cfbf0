//! Formats numbers; all rounding of printed values happens here.

/// Placeholder for a missing number.
pub(crate) const NONE: &str = "–";

/// Formats `value` with `decimals` decimals. Values that round to zero have no minus sign; values that are not finite
/// become a dash.
pub fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return NONE.into();
    }
    let text = format!("{value:.decimals$}");
    let is_zero = text.chars().all(|c| matches!(c, '-' | '0' | '.'));
    if is_zero { text.trim_start_matches('-').into() } else { text }
}

/// Formats a difference with an explicit sign, e.g. `+0.10` or `−0.10`.
pub fn signed(value: f64, decimals: usize) -> String {
    let text = number(value, decimals);
    if text.starts_with('-') { text.replacen('-', "−", 1) } else { format!("+{text}") }
}

//! Conditions: parameters that are set for some methods only.

use std::str::FromStr;

/// A parameter is set only if another one, or an axis of the recipe, has one of these values.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Condition {
    pub(crate) name: String,
    pub(crate) values: Vec<String>,
}

impl FromStr for Condition {
    type Err = String;

    /// Parses `NAME=VALUE` or `NAME=VALUE|VALUE`.
    fn from_str(text: &str) -> Result<Self, String> {
        let (name, values) = text.split_once('=').unwrap_or((text, ""));
        let values: Vec<String> = values.split('|').map(bare).collect();
        if name.trim().is_empty() || values.iter().any(String::is_empty) {
            return Err(format!("expected `when NAME=VALUE` or `when NAME=VALUE|VALUE`, not `when {text}`"));
        }
        Ok(Self { name: name.trim().into(), values })
    }
}

impl Condition {
    /// Whether it holds for this value, as TOML.
    pub(crate) fn allows(&self, value: &str) -> bool {
        self.values.contains(&bare(value))
    }

    /// Whether the condition names the parameter with this key, by the whole key or by its last part.
    pub(crate) fn is_about(&self, key: &str) -> bool {
        key == self.name || key.rsplit('.').next() == Some(&self.name)
    }
}

/// A value without the brackets and quotes of TOML: `["scgs"]` is `scgs`.
pub(crate) fn bare(value: &str) -> String {
    value.trim_matches(|c: char| c.is_whitespace() || "[]\"'".contains(c)).to_owned()
}

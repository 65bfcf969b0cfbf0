//! The base of a method, as parameters name it.

use std::collections::BTreeMap;
use std::str::FromStr;

/// A value of [`crate::TableGenerationParams::bases`]: a method, and the values of further axes that its rows must have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Base {
    /// The method's id.
    pub method: String,
    /// The values by axis.
    pub axes: BTreeMap<String, String>,
}

impl FromStr for Base {
    type Err = String;

    /// Reads e.g. `deformable4dgs steps=of-phys4dgs`. The error names the word that is malformed.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut words = text.split_whitespace();
        let method = words.next().filter(|word| !word.contains('='));
        let method = method.ok_or_else(|| format!("`{text}` does not begin with a method"))?;
        let value = |word: &str| {
            let parts = word.split_once('=').filter(|(axis, value)| !axis.is_empty() && !value.is_empty());
            let parts = parts.map(|(axis, value)| (axis.to_owned(), value.to_owned()));
            parts.ok_or_else(|| format!("`{word}` is not a value of an axis"))
        };
        Ok(Self { method: method.into(), axes: words.map(value).collect::<Result<_, String>>()? })
    }
}

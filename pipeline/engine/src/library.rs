//! The recipes that are built into the program. A recipe names one as `builtin:NAME`.

use std::path::{Path, PathBuf};

/// The prefix of names of built-in recipes.
const PREFIX: &str = "builtin:";

/// Built-in recipes: each with its name and its text, ordered by name.
pub type Builtins = &'static [(&'static str, &'static str)];

/// The built-in recipes of a registry.
#[derive(Clone, Copy)]
pub(crate) struct Library(pub(super) Builtins);

impl Library {
    /// The text of the recipe called `name`.
    pub(crate) fn text(self, name: &str) -> Option<&'static str> {
        self.0.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
    }

    /// All names.
    pub(crate) fn names(self) -> impl Iterator<Item = &'static str> {
        self.0.iter().map(|(name, _)| *name)
    }
}

/// The name of the built-in recipe that `path` names, if it names one.
pub fn builtin_name(path: &Path) -> Option<&str> {
    path.to_str()?.strip_prefix(PREFIX)
}

/// The path of a recipe that the recipe at `path` extends as `name`: built in, or relative to its folder.
pub(crate) fn extended_path(path: &Path, name: &str) -> PathBuf {
    if builtin_name(Path::new(name)).is_some() {
        return name.into();
    }
    path.parent().unwrap_or(Path::new("")).join(name)
}

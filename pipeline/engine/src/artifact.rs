//! Artifacts: folders of files that open as typed values.

use std::path::Path;

/// A typed artifact: a folder in the store that opens as `Self`.
///
/// A stage writes the files into [`crate::JobContext::output_dir`] and returns the value; the engine calls
/// [`Artifact::check`] on it, opens the folder again with [`Artifact::open`], checks what it read, and only then
/// publishes. Readers open and check as well, so a damaged artifact never spreads.
pub trait Artifact: Sized {
    /// The type's stable name, e.g. `"capture"`; part of the key of every job that reads or writes it.
    const NAME: &'static str;
    /// The version of the format. A new version changes the keys, so producers rerun.
    const SCHEMA: u32;

    /// Reads the folder `dir`. Errors name the file and the problem.
    fn open(dir: &Path) -> anyhow::Result<Self>;

    /// Checks the value's invariants: counts, sizes, units, finite numbers.
    fn check(&self) -> anyhow::Result<()>;
}

/// Declares the artifact type of a stage whose data type lives in `scene`, which does not depend on the engine: a
/// newtype that dereferences to `$inner`, opened by `$inner::open` and checked by `$inner::check`.
#[macro_export]
macro_rules! artifact {
    ($(#[$doc:meta])* pub struct $name:ident($inner:ty) = $label:literal @ $schema:expr;) => {
        $(#[$doc])*
        pub struct $name(pub $inner);

        impl $crate::Artifact for $name {
            const NAME: &'static str = $label;
            const SCHEMA: u32 = $schema;

            fn open(dir: &::std::path::Path) -> ::anyhow::Result<Self> {
                Ok(Self(<$inner>::open(dir)?))
            }

            fn check(&self) -> ::anyhow::Result<()> {
                Ok(self.0.check()?)
            }
        }

        impl ::std::ops::Deref for $name {
            type Target = $inner;

            fn deref(&self) -> &$inner {
                &self.0
            }
        }
    };
}

//! The tables of the papers under study, cell by cell as printed: the files of `claims/papers`.

mod claims;
mod compared;
mod quantity;
mod table;
#[cfg(test)]
mod tests;

pub(crate) use compared::{ComparedCell, Measured};
pub(crate) use table::{Heading, Paper, PaperTable};

//! The tables of the papers under study, cell by cell as printed: `claims/papers/*.toml`.

mod claims;
mod compared;
mod printed;
#[cfg(test)]
mod tests;

use anyhow::{Context as _, ensure};
use serde::Deserialize;

pub use compared::{ComparedCell, Measured};
pub use printed::Figure;

use crate::claims::{ClaimProtocol, Kind};

/// The papers, by the name that recipes know them by.
const FILES: [(&str, &str); 5] = [
    ("l4dgs", include_str!("../../claims/papers/l4dgs.toml")),
    ("phys4dgs", include_str!("../../claims/papers/phys4dgs.toml")),
    ("kineticgs", include_str!("../../claims/papers/kineticgs.toml")),
    ("mcgs", include_str!("../../claims/papers/mcgs.toml")),
    ("vcgs", include_str!("../../claims/papers/vcgs.toml")),
];

/// A paper.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Paper {
    /// What tables call it.
    pub name: String,
    /// Its title.
    pub title: String,
    /// The tables in the order of the paper.
    #[serde(rename = "table")]
    pub tables: Vec<PaperTable>,
}

/// One table of a paper, in its own shape.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperTable {
    /// As `Table 2` or `Figure 6a`.
    pub number: String,
    /// What it shows.
    pub caption: String,
    /// How the numbers came to be, as far as the paper states it.
    pub protocol: ClaimProtocol,
    /// The scenes that means are over; empty where the paper does not name them.
    #[serde(default)]
    pub scenes: Vec<String>,
    /// What is wrong or odd about the table.
    #[serde(default)]
    pub notes: Vec<String>,
    /// From left to right.
    pub columns: Vec<Heading>,
    /// From top to bottom.
    pub rows: Vec<Heading>,
}

/// A row or a column: what it is called, and what its cells have in common. What neither the row nor the column of a
/// cell says holds for the whole table.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Heading {
    /// As printed.
    pub label: String,
    /// A heading that it shares with its neighbours.
    pub group: Option<String>,
    /// What is measured.
    pub figure: Option<Figure>,
    /// The method's id, where it is one of this project.
    pub method: Option<String>,
    /// The value of a recipe's axis `ablation`.
    pub variant: Option<String>,
    /// Whether the variant is the whole method.
    pub full: bool,
    /// The scene; without one, cells are means.
    pub scene: Option<String>,
    /// The scenes that means are over, where they are not those of the table.
    pub scenes: Option<Vec<String>>,
    /// The protocol, where it is not that of the table.
    pub protocol: Option<ClaimProtocol>,
    /// Who measured.
    pub kind: Kind,
    /// What is odd about it.
    pub notes: Vec<String>,
    /// Rows: the printed cells, separated by `|`.
    pub values: String,
}

/// Every paper that is compiled in, checked.
pub fn built_in() -> anyhow::Result<Vec<Paper>> {
    FILES.iter().map(|(name, text)| parse(text).with_context(|| format!("tables of the paper {name}"))).collect()
}

/// The paper that recipes call `name`.
pub fn find(name: &str) -> anyhow::Result<Paper> {
    let (_, text) =
        FILES.iter().find(|(known, _)| *known == name).with_context(|| format!("no paper called {name}"))?;
    parse(text)
}

/// What recipes may call papers.
pub fn names() -> impl Iterator<Item = &'static str> {
    FILES.iter().map(|(name, _)| *name)
}

/// Reads and checks one file.
fn parse(text: &str) -> anyhow::Result<Paper> {
    let paper: Paper = toml::from_str(text)?;
    ensure!(!paper.tables.is_empty(), "no table");
    for table in &paper.tables {
        table.check().with_context(|| table.number.clone())?;
    }
    Ok(paper)
}

impl PaperTable {
    fn check(&self) -> anyhow::Result<()> {
        for row in &self.rows {
            let printed = row.cells();
            ensure!(
                printed.len() == self.columns.len(),
                "row {} has {} cells for {} columns",
                row.label,
                printed.len(),
                self.columns.len()
            );
            for (column, text) in self.columns.iter().zip(printed) {
                let Some(figure) = self.place(row, column).figure else { continue };
                let is_number = figure.value(text).is_none_or(|value| value.is_finite() && value > 0.0);
                let is_known = figure.value(text).is_some() || printed::says_no_number(text);
                ensure!(is_number && is_known, "{} of {} is {text:?}", column.label, row.label);
            }
        }
        Ok(())
    }

    /// Everything that row and column say of the cell where they meet; columns say it first.
    fn place<'a>(&'a self, row: &'a Heading, column: &'a Heading) -> Place<'a> {
        let variant = column.variant.as_ref().or(row.variant.as_ref());
        let scene = column.scene.as_ref().or(row.scene.as_ref());
        let mean_of = column.scenes.as_ref().or(row.scenes.as_ref()).unwrap_or(&self.scenes);
        Place {
            figure: column.figure.or(row.figure),
            method: column.method.as_deref().or(row.method.as_deref()),
            variant: variant.map(String::as_str),
            full: column.full || row.full,
            scenes: scene.map_or(mean_of.as_slice(), std::slice::from_ref),
            is_mean: scene.is_none(),
            protocol: column.protocol.as_ref().or(row.protocol.as_ref()).unwrap_or(&self.protocol),
        }
    }
}

/// What a cell is about.
struct Place<'a> {
    figure: Option<Figure>,
    method: Option<&'a str>,
    variant: Option<&'a str>,
    full: bool,
    scenes: &'a [String],
    is_mean: bool,
    protocol: &'a ClaimProtocol,
}

impl Heading {
    /// A row's cells as printed.
    pub fn cells(&self) -> Vec<&str> {
        self.values.split('|').map(str::trim).collect()
    }
}

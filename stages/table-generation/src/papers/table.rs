//! A paper's tables as data, with the meaning of every cell.

use anyhow::{Context as _, ensure};
use metric_evaluation::MaskName;
use serde::Deserialize;

use super::quantity::{Quantity, is_blank};
use crate::claims::{ClaimProtocol, Kind};

/// A paper.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Paper {
    /// Short name, used in tables.
    pub name: String,
    /// Title.
    pub title: String,
    /// Authors; none where the available copy does not name them.
    pub authors: Option<String>,
    /// Where it was published; none where the available copy does not state it.
    pub venue: Option<String>,
    /// The tables in the order of the paper.
    #[serde(rename = "table")]
    pub tables: Vec<PaperTable>,
}

/// One table of a paper, in its printed shape.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PaperTable {
    /// Number in the paper, e.g. `Table 2` or `Figure 6a`.
    pub number: String,
    /// Subject of the table.
    pub caption: String,
    /// The protocol, as far as the paper states it.
    pub protocol: ClaimProtocol,
    /// The mask of masked quantities; a table with such quantities has to name it.
    pub mask: Option<MaskName>,
    /// The scenes that means cover; empty where the paper does not name them.
    #[serde(default)]
    pub scenes: Vec<String>,
    /// Errors and inconsistencies of the table.
    #[serde(default)]
    pub notes: Vec<String>,
    /// Columns, from left to right.
    pub columns: Vec<Heading>,
    /// Rows, from top to bottom.
    pub rows: Vec<Heading>,
}

/// A row or a column: its label, and the properties that its cells share. A property that neither the row nor the
/// column of a cell sets is that of the table.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Heading {
    /// Label as printed.
    pub label: String,
    /// Heading shared with the neighbours.
    pub group: Option<String>,
    /// The quantity that the cells measure.
    pub quantity: Option<Quantity>,
    /// The method's id, if the method is part of this project.
    pub method: Option<String>,
    /// Value of a recipe's axis `ablation`.
    pub variant: Option<String>,
    /// Whether the variant is the whole method.
    pub full: bool,
    /// The scene; without one, cells are means.
    pub scene: Option<String>,
    /// The scenes that means cover, where they differ from those of the table.
    pub scenes: Option<Vec<String>>,
    /// The protocol, where it differs from that of the table.
    pub protocol: Option<ClaimProtocol>,
    /// The mask of masked quantities, where it differs from that of the table.
    pub mask: Option<MaskName>,
    /// Who measured the values.
    pub kind: Kind,
    /// Remarks on the row or column.
    pub notes: Vec<String>,
    /// Rows only: the printed cells, separated by `|`.
    pub values: String,
}

/// The properties that row and column give to the cell where they meet.
pub(super) struct Place<'a> {
    pub(super) quantity: Option<Quantity>,
    pub(super) method: Option<&'a str>,
    pub(super) variant: Option<&'a str>,
    pub(super) full: bool,
    pub(super) scenes: &'a [String],
    pub(super) is_mean: bool,
    pub(super) protocol: &'a ClaimProtocol,
    pub(super) mask: Option<MaskName>,
}

impl Paper {
    /// Parses and checks one file.
    pub(crate) fn parse(text: &str) -> anyhow::Result<Self> {
        let paper: Self = toml::from_str(text)?;
        ensure!(!paper.tables.is_empty(), "no table");
        for table in &paper.tables {
            table.check().with_context(|| table.number.clone())?;
        }
        Ok(paper)
    }

    /// Name, title, authors and venue in one line.
    pub(crate) fn reference(&self) -> String {
        let title = match self.title.starts_with(&self.name) {
            true => self.title.clone(),
            false => format!("{}: {}", self.name, self.title),
        };
        let details: Vec<&str> = [&self.authors, &self.venue].into_iter().flatten().map(String::as_str).collect();
        if details.is_empty() { title } else { format!("{title} ({})", details.join("; ")) }
    }
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
                let place = self.place(row, column);
                let Some(quantity) = place.quantity else { continue };
                let has_mask = !quantity.is_masked() || place.mask.is_some();
                ensure!(has_mask, "{} is over the pixels of a mask that the table does not name", column.label);
                let is_number = quantity.value(text).is_none_or(|value| value.is_finite() && value > 0.0);
                let is_known = quantity.value(text).is_some() || is_blank(text);
                ensure!(is_number && is_known, "{} of {} is {text:?}", column.label, row.label);
            }
        }
        Ok(())
    }

    /// The properties of the cell where `row` and `column` meet; those of the column take precedence.
    pub(super) fn place<'a>(&'a self, row: &'a Heading, column: &'a Heading) -> Place<'a> {
        let variant = column.variant.as_ref().or(row.variant.as_ref());
        let scene = column.scene.as_ref().or(row.scene.as_ref());
        let mean_of = column.scenes.as_ref().or(row.scenes.as_ref()).unwrap_or(&self.scenes);
        Place {
            quantity: column.quantity.or(row.quantity),
            method: column.method.as_deref().or(row.method.as_deref()),
            variant: variant.map(String::as_str),
            full: column.full || row.full,
            scenes: scene.map_or(mean_of.as_slice(), std::slice::from_ref),
            is_mean: scene.is_none(),
            protocol: column.protocol.as_ref().or(row.protocol.as_ref()).unwrap_or(&self.protocol),
            mask: column.mask.or(row.mask).or(self.mask),
        }
    }
}

impl Heading {
    /// A row's cells as printed.
    pub(crate) fn cells(&self) -> Vec<&str> {
        self.values.split('|').map(str::trim).collect()
    }
}

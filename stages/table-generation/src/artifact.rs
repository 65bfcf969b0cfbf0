//! The artifact: a folder that holds the report in every format.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use engine::Artifact;

use crate::document::Block;
use crate::params::TableGenerationParams;
use crate::pictures::Sheet;
use crate::report::Report;
use crate::{csv_file, html, latex, markdown, sections, svg_file};

const JSON: &str = "report.json";
const MARKDOWN: &str = "report.md";
const LATEX: &str = "report.tex";
const CSV: &str = "report.csv";
const FRAMES: &str = "frames.csv";
const HTML: &str = "index.html";

/// A folder with a report: `report.{json,md,tex,csv}`, `frames.csv`, `index.html` and one SVG file per figure.
#[derive(Clone, Debug, PartialEq)]
pub struct ReportFolder {
    /// Path of the folder.
    pub dir: PathBuf,
    /// The content of `report.json`; all other files derive from it.
    pub(crate) report: Report,
}

impl ReportFolder {
    /// Checks `report` and writes every format into `dir`. Equal reports yield equal bytes.
    pub(crate) fn write(
        report: Report,
        sheets: Vec<Sheet>,
        params: &TableGenerationParams,
        dir: &Path,
    ) -> anyhow::Result<Self> {
        report.check()?;
        let document = sections::document(&report, sheets, params)?;
        let mut files = vec![
            (JSON.to_owned(), serde_json::to_string_pretty(&report)? + "\n"),
            (MARKDOWN.to_owned(), markdown::markdown(&document)),
            (LATEX.to_owned(), latex::latex(&document)),
            (CSV.to_owned(), csv_file::runs(&report)?),
            (FRAMES.to_owned(), csv_file::frames(&report)?),
            (HTML.to_owned(), html::html(&document)),
        ];
        for block in document.sections.iter().flat_map(|section| &section.blocks) {
            if let Block::Figure(figure) = block {
                files.push((figure.file.clone(), svg_file::file(figure)));
            }
        }
        for (name, text) in files {
            let path = dir.join(name);
            std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(Self { dir: dir.into(), report })
    }

    /// The report as Markdown.
    pub fn markdown(&self) -> anyhow::Result<String> {
        let path = self.dir.join(MARKDOWN);
        std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))
    }
}

impl Artifact for ReportFolder {
    const NAME: &'static str = "report";
    const SCHEMA: u32 = 3;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        let path = dir.join(JSON);
        let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let report = serde_json::from_str(&text).with_context(|| format!("not a report: {}", path.display()))?;
        Ok(Self { dir: dir.into(), report })
    }

    fn check(&self) -> anyhow::Result<()> {
        self.report.check()?;
        for name in [JSON, MARKDOWN, LATEX, CSV, FRAMES, HTML] {
            let path = self.dir.join(name);
            let size = std::fs::metadata(&path).map(|file| file.len()).unwrap_or(0);
            ensure!(size > 0, "file is missing or empty: {}", path.display());
        }
        Ok(())
    }
}

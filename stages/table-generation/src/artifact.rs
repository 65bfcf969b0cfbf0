//! The artifact: a folder with the report in every format.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use engine::Artifact;

use crate::curves::{ALL_CURVES, svg_files};
use crate::{Report, TableGenerationParams, csv_file, html, latex, markdown, typeset};

const JSON: &str = "report.json";
const MARKDOWN: &str = "report.md";
const LATEX: &str = "report.tex";
const CSV: &str = "report.csv";
const HTML: &str = "index.html";

/// A report's folder: `report.{json,md,tex,csv}`, `index.html`, `curves.svg` and one SVG per scene.
#[derive(Clone, Debug, PartialEq)]
pub struct ReportFolder {
    /// The folder.
    pub dir: PathBuf,
    /// The content of `report.json`, from which every other file was made.
    pub report: Report,
}

impl ReportFolder {
    /// Checks `report` and writes every format into `dir`; equal reports give equal bytes.
    pub fn write(report: Report, params: &TableGenerationParams, dir: &Path) -> anyhow::Result<Self> {
        report.check()?;
        let document = typeset::document(&report, params);
        let mut files = vec![
            (JSON.to_owned(), serde_json::to_string_pretty(&report)? + "\n"),
            (MARKDOWN.to_owned(), markdown::markdown(&document)),
            (LATEX.to_owned(), latex::latex(&document)),
            (CSV.to_owned(), csv_file::csv(&report)?),
            (HTML.to_owned(), html::html(&document)),
        ];
        files.extend(svg_files(&report, params));
        for (name, text) in files {
            let path = dir.join(name);
            std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(Self { dir: dir.into(), report })
    }

    /// The report as Markdown, for a terminal.
    pub fn markdown(&self) -> anyhow::Result<String> {
        let path = self.dir.join(MARKDOWN);
        std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))
    }
}

impl Artifact for ReportFolder {
    const NAME: &'static str = "report";
    const SCHEMA: u32 = 1;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        let path = dir.join(JSON);
        let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let report = serde_json::from_str(&text).with_context(|| format!("not a report: {}", path.display()))?;
        Ok(Self { dir: dir.into(), report })
    }

    fn check(&self) -> anyhow::Result<()> {
        self.report.check()?;
        for name in [JSON, MARKDOWN, LATEX, CSV, HTML, ALL_CURVES] {
            let path = self.dir.join(name);
            let size = std::fs::metadata(&path).map(|file| file.len()).unwrap_or(0);
            ensure!(size > 0, "file is missing or empty: {}", path.display());
        }
        Ok(())
    }
}

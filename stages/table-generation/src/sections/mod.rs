//! What the report says, section by section.

mod ablation;
mod budgets;
mod cells;
mod costs;
mod curves;
mod failures;
mod frames;
mod hard_cases;
mod machine;
mod papers;
mod pareto;
mod protocols;
mod published;
mod runs;
mod traces;
mod verdicts;

use crate::document::{Block, Document, Section};
use crate::pictures::Sheet;
use crate::{Report, TableGenerationParams};
use traces::Traces;

/// What sections are made of.
struct Content<'a> {
    report: &'a Report,
    params: &'a TableGenerationParams,
    traces: Traces,
}

/// The whole report as a document; sections that have nothing to say are left out.
pub fn document(report: &Report, sheets: Vec<Sheet>, params: &TableGenerationParams) -> anyhow::Result<Document> {
    let content = Content { report, params, traces: Traces::new(report, params) };
    let everywhere = |id, heading, blocks| Section { id, heading, page_only: false, blocks };
    let on_page = |id, heading, blocks| Section { id, heading, page_only: true, blocks };
    let pictures = if sheets.is_empty() { Vec::new() } else { vec![Block::Pictures(sheets)] };
    let mut sections = vec![
        everywhere("verdicts", "Verdicts", verdicts::blocks(&content)),
        everywhere("papers", "Tables of the papers", papers::blocks(&content)?),
        everywhere("results", "Results", protocols::blocks(&content)),
        everywhere("published", "Beside published values", published::blocks(&content)),
        everywhere("pareto", "Accuracy against cost", pareto::blocks(&content)),
        everywhere("curves", "Quality over training time", curves::blocks(&content)?),
        everywhere("budgets", "Deadlines", budgets::blocks(&content)),
        everywhere("ablation", "What each effect is worth", ablation::blocks(&content)),
        everywhere("costs", "Where the time goes", costs::blocks(&content)),
        everywhere("frames", "Frame by frame", frames::blocks(&content)),
        on_page("images", "Renders, truth and error", pictures),
        everywhere("hard-cases", "Hard cases", hard_cases::blocks(&content)),
        everywhere("failures", "Failures", failures::blocks(&content)),
        everywhere("machine", "Machine", machine::blocks(&content)),
        on_page("runs", "Runs", runs::blocks(&content)),
    ];
    sections.retain(|section| !section.blocks.is_empty());
    Ok(Document { title: report.title.clone(), sections })
}

//! The content of the report, section by section.

mod ablation;
mod budgets;
mod cells;
mod content;
mod costs;
mod curves;
mod failures;
mod frames;
mod influence;
mod machine;
mod outcomes;
mod papers;
mod pareto;
mod prompts;
mod protocols;
mod published;
mod runs;
mod summary;
mod traces;
mod verdicts;

use crate::document::{Block, Document, Section};
use crate::params::TableGenerationParams;
use crate::pictures::Sheet;
use crate::report::Report;
use content::Content;
use traces::Traces;

/// The whole report as a document, without empty sections.
pub(crate) fn document(
    report: &Report,
    sheets: Vec<Sheet>,
    params: &TableGenerationParams,
) -> anyhow::Result<Document> {
    let content = Content { report, params, traces: Traces::new(report, params) };
    let everywhere = |id, heading, blocks| Section { id, heading, page_only: false, blocks };
    let on_page = |id, heading, blocks| Section { id, heading, page_only: true, blocks };
    let pictures = if sheets.is_empty() { Vec::new() } else { vec![Block::Pictures(sheets)] };
    let published =
        verdicts::table(&content).map(Block::Table).into_iter().chain(published::blocks(&content)).collect();
    let mut sections = vec![
        everywhere("summary", "Summary", summary::blocks(&content)),
        everywhere("results", "Results", protocols::blocks(&content)),
        on_page("images", "Renders and errors", pictures),
        everywhere("papers", "Tables of the papers", papers::blocks(&content)?),
        everywhere("published", "Comparison with published values", published),
        everywhere("pareto", "Accuracy against cost", pareto::blocks(&content)),
        everywhere("curves", "Quality over training time", curves::blocks(&content)?),
        everywhere("budgets", "Quality under deadlines", budgets::blocks(&content)),
        everywhere("ablation", "Ablations", ablation::blocks(&content)),
        everywhere("influence", "Influence of losses and effects", influence::blocks(&content)),
        everywhere("costs", "Training costs", costs::blocks(&content)),
        everywhere("frames", "Quality per frame", frames::blocks(&content)),
        everywhere("outcomes", "Outcomes", outcomes::blocks(&content)),
        everywhere("failures", "Failures", failures::blocks(&content)),
        everywhere("machine", "Machines", machine::blocks(&content)),
        on_page("runs", "Runs", runs::blocks(&content)),
    ];
    sections.retain(|section| !section.blocks.is_empty());
    Ok(Document { title: report.title.clone(), sections })
}

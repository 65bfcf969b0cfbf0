//! The stage: collects the runs of a recipe and writes their report.

use engine::{JobContext, ParamProblem, Port, Stage};
use metric_evaluation::Metrics;
use rendering::Renders;
use training::Model;

use crate::collect::collect;
use crate::{Report, ReportFolder, TableGenerationParams, built_in_claims};

/// The stage `table-generation`.
pub struct TableGeneration;

impl Stage for TableGeneration {
    type Params = TableGenerationParams;
    type Output = ReportFolder;

    const ID: &'static str = "table-generation";
    const ABOUT: &'static str = "writes tables and curves of all runs, beside published values";

    fn ports() -> Vec<Port> {
        vec![
            Port::many::<Model>("model").with_measurements(),
            Port::many::<Renders>("renders").with_measurements(),
            Port::many::<Metrics>("metrics"),
        ]
    }

    fn check_params(params: &Self::Params) -> Vec<ParamProblem> {
        let tolerance_db = params.reproduced_within_db;
        let problem = ParamProblem {
            key: "reproduced_within_db".into(),
            message: format!("a tolerance of {tolerance_db} dB"),
            hint: Some("use a positive number, as 0.3".into()),
        };
        if tolerance_db.is_finite() && tolerance_db > 0.0 { Vec::new() } else { vec![problem] }
    }

    fn run(context: &JobContext, params: &Self::Params) -> anyhow::Result<ReportFolder> {
        let report = Report::new(collect(context)?, &built_in_claims()?, params);
        ReportFolder::write(report, params, context.output_dir())
    }
}

//! The stage: collects the runs of a recipe and writes a report.

use captures::CaptureArtifact;
use engine::{JobContext, ParamProblem, Port, Stage};
use metric_evaluation::Metrics;
use rendering::Renders;
use training::Model;

use crate::artifact::ReportFolder;
use crate::collect::Inputs;
use crate::params::TableGenerationParams;
use crate::report::Report;
use crate::{library, pictures};

/// The stage `table-generation`.
pub struct TableGeneration;

impl Stage for TableGeneration {
    type Params = TableGenerationParams;
    type Output = ReportFolder;

    const ID: &'static str = "table-generation";
    const ABOUT: &'static str = "writes tables, curves and an HTML page of all runs next to published values";

    fn ports() -> Vec<Port> {
        vec![
            Port::many::<Model>("model").with_measurements(),
            Port::many::<Renders>("renders").with_measurements(),
            Port::many::<Metrics>("metrics"),
            Port::many::<CaptureArtifact>("capture"),
        ]
    }

    fn check_params(params: &Self::Params) -> Vec<ParamProblem> {
        params.problems()
    }

    fn run(context: &JobContext, params: &Self::Params) -> anyhow::Result<ReportFolder> {
        let inputs = Inputs::open(context)?;
        let report = Report::new(inputs.runs()?, &library::claims()?, params);
        let sheets = pictures::sheets(&report, &inputs, params)?;
        ReportFolder::write(report, sheets, params, context.output_dir())
    }
}

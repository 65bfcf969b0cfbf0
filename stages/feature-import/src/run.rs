//! The stage: features of a capture.

use std::path::Path;

use engine::{JobContext, ParamProblem, Port, Resources, Stage};
use rayon::prelude::*;
use scene::Capture;

use crate::artifact::TokenView;
use crate::labels::Vocabulary;
use crate::{FeatureSource, Features, Params};

engine::artifact! {
    /// The capture that the features describe.
    pub struct CaptureArtifact(Capture) = "capture" @ scene::capture::SCHEMA;
}

/// The stage `feature-import`.
pub struct FeatureImport;

impl Stage for FeatureImport {
    type Params = Params;
    type Output = Features;

    const ID: &'static str = "feature-import";
    const ABOUT: &'static str =
        "brings visual tokens and text embeddings (CLIP's, or exact ones from labels) to a capture";

    fn ports() -> Vec<Port> {
        vec![Port::one::<CaptureArtifact>("capture")]
    }

    fn check_params(params: &Params) -> Vec<ParamProblem> {
        params.problems()
    }

    fn resources(_params: &Params) -> Resources {
        Resources { threads: 0 } // views are independent
    }

    fn run(context: &JobContext, params: &Params) -> anyhow::Result<Features> {
        let capture = context.input::<CaptureArtifact>("capture")?.0;
        let dir = context.output_dir();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(context.threads).build()?;
        pool.install(|| import(&capture, params, dir))
    }
}

/// Writes the features of `capture` into the folder `dir`.
pub fn import(capture: &Capture, params: &Params, dir: &Path) -> anyhow::Result<Features> {
    match params.source {
        FeatureSource::Labels => from_labels(capture, params, dir),
    }
}

/// Exact features of every view.
fn from_labels(capture: &Capture, params: &Params, dir: &Path) -> anyhow::Result<Features> {
    let vocabulary = Vocabulary::of(capture, params)?;
    let mut features = Features {
        dir: dir.into(),
        source: "labels".into(),
        dimension: params.dimension,
        prompts: vocabulary.prompts.clone(),
        views: Vec::new(),
    };
    features.create_folders()?;
    let views = capture.views.par_iter().map(|view| {
        let tokens = vocabulary.tokens(capture, view, params.grid)?;
        features.write_tokens(&view.name, &tokens)?;
        Ok(TokenView { name: view.name.clone(), grid: Some([tokens.rows, tokens.columns]) })
    });
    features.views = views.collect::<anyhow::Result<_>>()?;
    features.finish(&vocabulary.embeddings)?;
    Ok(features)
}

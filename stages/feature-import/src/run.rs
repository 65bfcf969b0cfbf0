//! The stage: writes language features of every view of a capture.

use std::path::Path;

use captures::CaptureArtifact;
use engine::{JobContext, ParamProblem, Port, Resources, Source, Stage};
use rayon::prelude::*;
use scene::{Capture, View};

use crate::artifact::{TokenGrid, TokenView};
use crate::files::FeatureFiles;
use crate::labels::Vocabulary;
use crate::params::FeatureSource;
use crate::{Features, Params};

/// Name of the source folder of features.
const FOLDER: &str = "folder";

/// The stage `feature-import`.
pub struct FeatureImport;

impl Stage for FeatureImport {
    type Params = Params;
    type Output = Features;

    const ID: &'static str = "feature-import";
    const ABOUT: &'static str =
        "imports visual tokens and text embeddings (from CLIP, or exact ones from labels) for a capture";

    fn ports() -> Vec<Port> {
        vec![Port::one::<CaptureArtifact>("capture")]
    }

    fn sources(params: &Params) -> Vec<Source> {
        match params.source {
            FeatureSource::Labels => Vec::new(),
            FeatureSource::Files => vec![Source { name: FOLDER, path: params.folder.clone() }],
        }
    }

    fn check_params(params: &Params) -> Vec<ParamProblem> {
        params.problems()
    }

    fn resources(_params: &Params) -> Resources {
        Resources { threads: 0 } // views are independent
    }

    fn run(context: &JobContext, params: &Params) -> anyhow::Result<Features> {
        let capture = context.input::<CaptureArtifact>("capture")?.0;
        let folder = match params.source {
            FeatureSource::Labels => None,
            FeatureSource::Files => Some(context.source(FOLDER)?),
        };
        let dir = context.output_dir();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(context.threads).build()?;
        let features = pool.install(|| match folder {
            None => from_labels(&capture, params, dir),
            Some(folder) => from_files(&capture, folder, dir),
        })?;
        let with_tokens = features.views.iter().filter(|view| view.grid.is_some()).count();
        context.measure("views_with_tokens", with_tokens)?;
        Ok(features)
    }
}

/// Writes exact features from the instance labels of every view of `capture` into the folder `dir`.
pub(crate) fn from_labels(capture: &Capture, params: &Params, dir: &Path) -> anyhow::Result<Features> {
    let vocabulary = Vocabulary::of(capture, params)?;
    let tokens = |view: &View| Ok(Some(vocabulary.tokens(capture, view, params.grid)?));
    let text = Text { prompts: &vocabulary.prompts, embeddings: &vocabulary.embeddings, dimension: params.dimension };
    write(capture, "labels", text, tokens, dir)
}

/// Imports the features of `capture` from the files below `folder` into the folder `dir`.
pub(crate) fn from_files(capture: &Capture, folder: &Path, dir: &Path) -> anyhow::Result<Features> {
    let files = FeatureFiles::open(folder, capture)?;
    let text = Text { prompts: &files.prompts, embeddings: &files.text, dimension: files.dimension };
    write(capture, "files", text, |view| files.tokens(view), dir)
}

/// Prompts and their embeddings [P, F].
struct Text<'a> {
    prompts: &'a [String],
    embeddings: &'a [f32],
    dimension: usize,
}

/// Writes the tokens of all views, the text embeddings and the index.
fn write(
    capture: &Capture,
    source: &str,
    text: Text<'_>,
    tokens: impl Fn(&View) -> anyhow::Result<Option<TokenGrid>> + Sync,
    dir: &Path,
) -> anyhow::Result<Features> {
    let prompts = text.prompts.to_vec();
    let mut features =
        Features { dir: dir.into(), source: source.into(), dimension: text.dimension, prompts, views: Vec::new() };
    features.create_folders()?;
    let views = capture.views.par_iter().map(|view| {
        let tokens = tokens(view)?;
        tokens.iter().try_for_each(|tokens| features.write_tokens(&view.name, tokens))?;
        Ok(TokenView { name: view.name.clone(), grid: tokens.map(|tokens| [tokens.rows, tokens.columns]) })
    });
    features.views = views.collect::<anyhow::Result<_>>()?;
    features.finish(text.embeddings)?;
    Ok(features)
}

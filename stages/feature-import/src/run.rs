//! The stage: writes language features of every view of a capture.

use std::path::Path;

use captures::{CaptureArtifact, record_shift, shift_by_changes};
use engine::{Failure, FailureKind, JobContext, ParamProblem, Port, Resources, Source, Stage};
use rayon::prelude::*;
use scene::{Capture, Naming, Split, View};

use crate::artifact::{TokenGrid, TokenView};
use crate::files::FeatureFiles;
use crate::labels::Vocabulary;
use crate::params::FeatureSource;
use crate::text::TextEmbeddings;
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
            FeatureSource::Files => vec![Source::required(FOLDER, params.folder.clone())],
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
            Some(folder) => from_files(&capture, folder, params.naming, dir),
        })?;
        if folder.is_some() {
            let shift = better_shift_of(&features, &capture)?;
            record_shift(context, "tokens_fit_images_better_shifted_by_frames", "tokens fit the images", shift)?;
        }
        let with_tokens = features.views.iter().filter(|view| view.grid.is_some()).count();
        context.measure("views_with_tokens", with_tokens)?;
        Ok(features)
    }
}

/// Writes exact features from the instance labels of every view of `capture` into the folder `dir`.
pub(crate) fn from_labels(capture: &Capture, params: &Params, dir: &Path) -> anyhow::Result<Features> {
    let vocabulary = Vocabulary::of(capture, params)?;
    let dimension = params.dimension;
    let tokens = |view: &View| Ok(Some((vocabulary.tokens(capture, view, params.grid)?, dimension)));
    let text = TextEmbeddings { prompts: vocabulary.prompts.clone(), values: vocabulary.embeddings.clone(), dimension };
    write(capture, "labels", Some(&text), tokens, dir)
}

/// Imports the features of `capture` from the files below `folder`, whose names are interpreted by `naming`, into the
/// folder `dir`.
pub(crate) fn from_files(capture: &Capture, folder: &Path, naming: Naming, dir: &Path) -> anyhow::Result<Features> {
    let files = FeatureFiles::open(folder, capture, naming)?;
    write(capture, "files", files.text.as_ref(), |view| files.tokens(view), dir)
}

/// The shift by one frame with which the tokens change where the images change; `None` without one.
pub(crate) fn better_shift_of(features: &Features, capture: &Capture) -> anyhow::Result<Option<i64>> {
    shift_by_changes(capture, |view| Ok(features.load_tokens(view)?.map(TokenGrid::into_map)))
}

/// Writes the tokens of all views, the text embeddings and the index.
fn write(
    capture: &Capture,
    source: &str,
    text: Option<&TextEmbeddings>,
    tokens: impl Fn(&View) -> anyhow::Result<Option<(TokenGrid, usize)>> + Sync,
    dir: &Path,
) -> anyhow::Result<Features> {
    let prompts = text.map_or_else(Vec::new, |text| text.prompts.clone());
    let first = capture.views_of(Split::Train).next().map(|(_, view)| tokens(view)).transpose()?.flatten();
    let dimension = text.map(|text| text.dimension).or(first.map(|(_, dimension)| dimension)).unwrap_or(0);
    let mut features = Features { dir: dir.into(), source: source.into(), dimension, prompts, views: Vec::new() };
    features.create_folders()?;
    let views = capture.views.par_iter().map(|view| {
        let tokens = tokens(view)?;
        if let Some((_, other)) = tokens.as_ref().filter(|(_, other)| *other != dimension) {
            let message = format!("the tokens of {} have dimension {other}, those of others {dimension}", view.name);
            return Err(Failure::new(FailureKind::BadInput, message).into());
        }
        tokens.iter().try_for_each(|(tokens, _)| features.write_tokens(&view.name, tokens))?;
        Ok(TokenView { name: view.name.clone(), grid: tokens.map(|(tokens, _)| [tokens.rows, tokens.columns]) })
    });
    features.views = views.collect::<anyhow::Result<_>>()?;
    features.finish(text.map(|text| text.values.as_slice()))?;
    Ok(features)
}

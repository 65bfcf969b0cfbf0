//! Adds what a model says in words, where it says anything and the capture has labels to compare it with.

use std::collections::BTreeMap;

use rayon::prelude::*;
use rendering::RenderedView;
use scene::View;

use crate::metrics::{ClassFeatures, PromptLabels, class_features, feature_drifts, prompt_overlaps};
use crate::test_set::TestSet;
use crate::{ImageMetrics, Metric, MetricEvaluationParams, Score};

/// Why a model with semantic features selects nothing.
const NO_WORDS: &str = "the model was not told what its prompts look like";
/// Why there is nothing to compare a view's answers with.
const NOTHING_IN_SIGHT: &str = "no prompt has the name of a class in sight";
/// Why the features of a view cannot drift.
const SEEN_ONCE: &str = "no class of the image is in sight in another one";

/// Compares prompts and features of every image of the set with its labels; returns the overlaps by prompt
/// ([`crate::Metrics::prompts`]).
pub fn add(
    images: &mut [ImageMetrics],
    set: &TestSet<'_>,
    params: &MetricEvaluationParams,
) -> anyhow::Result<BTreeMap<String, Score>> {
    let wanted = |metric| params.metrics.contains(&metric);
    if !wanted(Metric::PromptIou) && !wanted(Metric::FeatureDrift) {
        return Ok(BTreeMap::new());
    }
    let prompts = PromptLabels::new(&set.renders.prompts, set.capture.label_names());
    let said: Vec<Option<Said>> = set
        .views
        .par_iter()
        .map(|(rendered, view)| compare(set, &prompts, rendered, view))
        .collect::<Result<_, _>>()?;
    let features: Vec<ClassFeatures> = said.iter().flatten().map(|said| said.features.clone()).collect();
    let mut drifts = feature_drifts(&features).into_iter();
    for (image, said) in images.iter_mut().zip(said) {
        let Some(said) = said else { continue };
        if wanted(Metric::PromptIou) {
            image.values.insert(Metric::PromptIou, said.mean_overlap());
            image.prompt_ious = said.overlaps;
        }
        let drift = drifts.next().flatten();
        if wanted(Metric::FeatureDrift) {
            let score = drift.map_or_else(|| Score::undefined(SEEN_ONCE), Score::Value);
            image.values.insert(Metric::FeatureDrift, score);
        }
    }
    let overlaps = mean_overlaps(images);
    let left_out = prompts.without_class().map(|prompt| (prompt.to_owned(), Score::undefined("no class of this name")));
    Ok(overlaps.into_iter().chain(left_out).collect())
}

/// The mean over the images that show what a prompt means, by prompt.
pub fn mean_overlaps(images: &[ImageMetrics]) -> BTreeMap<String, Score> {
    let mut values = BTreeMap::<&str, Vec<f64>>::new();
    for (prompt, overlap) in images.iter().flat_map(|image| &image.prompt_ious) {
        values.entry(prompt).or_default().push(*overlap);
    }
    let mean = |(prompt, values): (&str, Vec<f64>)| {
        (prompt.to_owned(), Score::Value(values.iter().sum::<f64>() / values.len() as f64))
    };
    values.into_iter().map(mean).collect()
}

/// What the render of one view says in words, compared with the view's labels.
struct Said {
    knows_words: bool,
    overlaps: BTreeMap<String, f64>,
    features: ClassFeatures,
}

impl Said {
    fn mean_overlap(&self) -> Score {
        match self.overlaps.len() {
            _ if !self.knows_words => Score::undefined(NO_WORDS),
            0 => Score::undefined(NOTHING_IN_SIGHT),
            count => Score::Value(self.overlaps.values().sum::<f64>() / count as f64),
        }
    }
}

/// None where the render says nothing, or the view has no labels.
fn compare(
    set: &TestSet<'_>,
    prompts: &PromptLabels,
    rendered: &RenderedView,
    view: &View,
) -> anyhow::Result<Option<Said>> {
    let Some(maps) = set.renders.load_semantics(rendered)? else { return Ok(None) };
    set.check_size(view, (maps.width, maps.height))?;
    let Some(labels) = labels(set, view)? else { return Ok(None) };
    Ok(Some(Said {
        knows_words: !maps.relevancy.is_empty(),
        overlaps: prompt_overlaps(&maps, &labels, prompts),
        features: class_features(&maps, &labels),
    }))
}

/// The labels of a view; none for pixels of the background where the capture knows that nothing is in sight.
fn labels(set: &TestSet<'_>, view: &View) -> anyhow::Result<Option<Vec<Option<u8>>>> {
    let Some(mask) = set.capture.load_mask(view)? else { return Ok(None) };
    let alpha = set.capture.load_alpha(view)?;
    let is_empty = |at: usize| alpha.as_ref().is_some_and(|alpha| alpha.as_raw()[at] < 128);
    let label = |(at, label): (usize, u8)| (label > 0 || !is_empty(at)).then_some(label);
    Ok(Some(mask.labels.into_iter().enumerate().map(label).collect()))
}

//! Adds prompt overlap and feature drift, for models with semantic features on captures with labels.

use std::collections::BTreeMap;

use rayon::prelude::*;
use rendering::RenderedView;
use scene::View;

use crate::artifact::{ImageMetrics, mean_overlaps};
use crate::metrics::language::{ClassFeatures, PromptLabels, class_features, feature_drifts, prompt_overlaps};
use crate::metrics::metric::Metric;
use crate::metrics::prompt_prior::{ClassCounts, trivial_overlaps};
use crate::metrics::score::Score;
use crate::params::MetricEvaluationParams;
use crate::test_set::TestSet;

/// Reason for an undefined overlap: the model has features, but cannot decode prompts.
const NO_PROMPTS: &str = "the model has no prompt embeddings";
/// Reason for an undefined overlap: the view shows no class of any prompt.
const NOT_VISIBLE: &str = "no visible class has the name of a prompt";
/// Reason for an undefined drift: a class needs two images.
const SEEN_ONCE: &str = "no class of the image is visible in another image";

/// Compares prompts and features of all images with the labels. Returns the overlaps per prompt
/// ([`crate::Metrics::prompts`]).
pub(crate) fn add(
    images: &mut [ImageMetrics],
    set: &TestSet<'_>,
    params: &MetricEvaluationParams,
) -> anyhow::Result<BTreeMap<String, Score>> {
    let wanted = |metric| params.metrics.contains(&metric);
    if !wanted(Metric::PromptIou) && !wanted(Metric::FeatureDrift) {
        return Ok(BTreeMap::new());
    }
    let prompts = PromptLabels::new(&set.renders.prompts, set.capture.label_names());
    let comparisons: Vec<Option<Comparison>> = set
        .views
        .par_iter()
        .map(|(rendered, view)| compare(set, &prompts, rendered, view))
        .collect::<Result<_, _>>()?;
    let features: Vec<ClassFeatures> = comparisons.iter().flatten().map(|found| found.features.clone()).collect();
    let mut drifts = feature_drifts(&features).into_iter();
    for (image, found) in images.iter_mut().zip(comparisons) {
        let Some(found) = found else { continue };
        if wanted(Metric::PromptIou) {
            image.values.insert(Metric::PromptIou, found.mean_overlap());
            image.prompt_ious = found.overlaps;
        }
        let drift = drifts.next().flatten();
        if wanted(Metric::FeatureDrift) {
            let score = drift.map_or_else(|| Score::undefined(SEEN_ONCE), Score::Value);
            image.values.insert(Metric::FeatureDrift, score);
        }
    }
    if wanted(Metric::PromptIou) {
        add_trivial(images, set, &prompts)?;
    }
    let overlaps = mean_overlaps(images);
    let unmatched =
        prompts.without_class().map(|prompt| (prompt.to_owned(), Score::undefined("no class of this name")));
    Ok(overlaps.into_iter().chain(unmatched).collect())
}

/// Adds the overlaps of answers that need no model to images with overlaps.
fn add_trivial(images: &mut [ImageMetrics], set: &TestSet<'_>, prompts: &PromptLabels) -> anyhow::Result<()> {
    if images.iter().all(|image| image.prompt_ious.is_empty()) {
        return Ok(());
    }
    let mut counts = ClassCounts::new(prompts);
    for (_, view) in &set.views {
        labels(set, view)?.iter().for_each(|labels| counts.add(labels, prompts));
    }
    let overlaps = set
        .views
        .par_iter()
        .map(|(_, view)| Ok(labels(set, view)?.map_or_else(Vec::new, |labels| counts.overlaps(&labels, prompts))));
    let overlaps: Vec<_> = overlaps.collect::<anyhow::Result<_>>()?;
    for (image, trivial) in images.iter_mut().zip(trivial_overlaps(&overlaps, &set.renders.prompts)) {
        image.trivial_ious = trivial.into_iter().filter(|(prompt, _)| image.prompt_ious.contains_key(prompt)).collect();
    }
    Ok(())
}

/// The comparison of one render with the labels of its view.
struct Comparison {
    has_prompts: bool,
    overlaps: BTreeMap<String, f64>,
    features: ClassFeatures,
}

impl Comparison {
    fn mean_overlap(&self) -> Score {
        match self.overlaps.len() {
            _ if !self.has_prompts => Score::undefined(NO_PROMPTS),
            0 => Score::undefined(NOT_VISIBLE),
            count => Score::Value(self.overlaps.values().sum::<f64>() / count as f64),
        }
    }
}

/// Compares one render with the labels of its view; `None` if the render has no semantics or the view has no labels.
fn compare(
    set: &TestSet<'_>,
    prompts: &PromptLabels,
    rendered: &RenderedView,
    view: &View,
) -> anyhow::Result<Option<Comparison>> {
    let Some(maps) = set.renders.load_semantics(rendered)? else { return Ok(None) };
    set.check_size(view, (maps.width, maps.height))?;
    let Some(labels) = labels(set, view)? else { return Ok(None) };
    Ok(Some(Comparison {
        has_prompts: !maps.relevancy.is_empty(),
        overlaps: prompt_overlaps(&maps, &labels, prompts),
        features: class_features(&maps, &labels),
    }))
}

/// The labels of a view; `None` for background pixels that are transparent in the capture.
fn labels(set: &TestSet<'_>, view: &View) -> anyhow::Result<Option<Vec<Option<u8>>>> {
    let Some(mask) = set.capture.load_mask(view)? else { return Ok(None) };
    let empty = set.empty_pixels(view)?;
    let is_empty = |at: usize| empty.as_ref().is_some_and(|empty| empty[at]);
    let label = |(at, label): (usize, u8)| (label > 0 || !is_empty(at)).then_some(label);
    Ok(Some(mask.labels.into_iter().enumerate().map(label).collect()))
}

//! Adds LPIPS, if its weights are available.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use engine::Failure;

use crate::artifact::ImageMetrics;
use crate::image_file::{Background, Image};
use crate::lpips::weights::{Weights, missing_file};
use crate::lpips::{Backbone, InputRange, Lpips};
use crate::metrics::metric::Metric;
use crate::metrics::score::Score;
use crate::pairs::Pair;
use crate::params::MetricEvaluationParams;

/// All variants with their classifier and input range.
const VARIANTS: [(Metric, Backbone, InputRange); 5] = [
    (Metric::LpipsAlex, Backbone::Alex, InputRange::Signed),
    (Metric::LpipsVgg, Backbone::Vgg, InputRange::Signed),
    (Metric::LpipsSqueeze, Backbone::Squeeze, InputRange::Signed),
    (Metric::LpipsAlexLegacy, Backbone::Alex, InputRange::Unsigned),
    (Metric::LpipsVggLegacy, Backbone::Vgg, InputRange::Unsigned),
];
/// Reason for an undefined LPIPS without a folder of weights below the data root.
pub(crate) const NO_WEIGHTS: &str =
    "no LPIPS weights: `pipeline data fetch lpips` puts them into the folder lpips below the data root";
/// Reason for an undefined LPIPS of two folders of images, which have no data root.
pub(crate) const NO_OPTION: &str = "no LPIPS weights: pass --lpips-weights DIR, e.g. the folder lpips below the data \
                                    root, into which `pipeline data fetch lpips` puts them";

/// The classifier that a metric needs, if any.
fn backbone(metric: Metric) -> Option<Backbone> {
    let variant = VARIANTS.into_iter().find(|(variant, ..)| *variant == metric);
    let of_mask = (metric == Metric::MaskedLpips).then_some(Backbone::Alex);
    variant.map(|(_, backbone, _)| backbone).or(of_mask)
}

/// The reason why a metric is undefined with the weights in `folder`, if a file is missing. Hashes are not checked.
pub fn missing_weights(metric: Metric, folder: &Path) -> Option<String> {
    missing_file(folder, backbone(metric)?)
}

/// The classifiers that the wanted metrics need.
pub(crate) struct Networks(BTreeMap<Backbone, Weights>);

impl Networks {
    /// Reads the weights in `folder` that the wanted metrics need; without a folder, LPIPS is undefined for the reason `absent`.
    ///
    /// # Errors
    /// A file with a published name and another content.
    pub(crate) fn open(folder: Option<&Path>, wanted: &BTreeSet<Metric>, absent: &str) -> Result<Self, Failure> {
        let needed: BTreeSet<Backbone> = wanted.iter().filter_map(|metric| backbone(*metric)).collect();
        let open = |backbone| {
            let weights = match folder {
                Some(folder) => Weights::open(folder, backbone)?,
                None => Weights::Missing(absent.into()),
            };
            Ok((backbone, weights))
        };
        needed.into_iter().map(open).collect::<Result<_, _>>().map(Self)
    }

    /// The value of `measure` with a classifier, or the reason why it is undefined.
    pub(crate) fn score(&self, backbone: Backbone, measure: impl FnOnce(&Lpips) -> Option<f64>) -> Score {
        match self.0.get(&backbone) {
            Some(Weights::Ready(lpips)) => {
                measure(lpips).map_or_else(|| Score::undefined("image too small for the network"), Score::Value)
            }
            Some(Weights::Missing(reason)) => Score::undefined(reason),
            None => Score::undefined(NO_WEIGHTS),
        }
    }

    fn is_any_ready(&self) -> bool {
        self.0.values().any(|weights| matches!(weights, Weights::Ready(_)))
    }
}

/// Adds all wanted variants to one image. Images are processed one by one, because a network uses all threads itself and
/// its features take a hundred times the memory of an image.
pub(crate) fn add(
    image: &mut ImageMetrics,
    pair: &Pair,
    networks: &Networks,
    params: &MetricEvaluationParams,
    background: Option<Background>,
) -> Result<(), Failure> {
    let wanted = || VARIANTS.into_iter().filter(|(metric, ..)| params.metrics.contains(metric));
    if !networks.is_any_ready() {
        let score = |(metric, backbone, _)| (metric, networks.score(backbone, |_| None));
        image.values.extend(wanted().map(score));
        return Ok(());
    }
    let read = |path| Image::read(path, params.quantise, background);
    let (render, truth) = (read(&pair.render)?, read(&pair.truth)?);
    let score = |(metric, backbone, range)| {
        (metric, networks.score(backbone, |lpips| lpips.distance([&render, &truth], range)))
    };
    image.values.extend(wanted().map(score));
    Ok(())
}

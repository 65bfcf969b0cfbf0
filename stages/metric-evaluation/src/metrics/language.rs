//! Metrics of rendered semantics against labels: the region that a prompt selects, and the drift of features over time.

use std::collections::BTreeMap;

use rendering::SemanticMaps;

/// The instance label of each pixel; `None` for empty pixels, which belong to no class.
pub(crate) type Labels = [Option<u8>];

/// The mean feature per class, scaled to unit length.
pub(crate) type ClassFeatures = BTreeMap<u8, Vec<f64>>;

/// The labels that each prompt stands for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PromptLabels(Vec<(String, Vec<u8>)>);

impl PromptLabels {
    /// A prompt stands for every label with its name, ignoring case and surrounding spaces.
    pub(crate) fn new<'a>(prompts: &[String], label_names: impl Iterator<Item = &'a str>) -> Self {
        let plain = |text: &str| text.trim().to_lowercase();
        let names: Vec<String> = label_names.map(plain).collect();
        let labels_of = |prompt: &String| {
            let labels = names.iter().zip(0..=u8::MAX).filter(|(name, _)| **name == plain(prompt));
            labels.map(|(_, label)| label).collect()
        };
        Self(prompts.iter().map(|prompt| (prompt.clone(), labels_of(prompt))).collect())
    }

    /// The number of prompts.
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether a pixel shows a class of a prompt.
    pub(crate) fn shows(&self, prompt: usize, label: Option<u8>) -> bool {
        label.is_some_and(|label| self.0[prompt].1.contains(&label))
    }

    /// The prompts without a label of their name.
    pub(crate) fn without_class(&self) -> impl Iterator<Item = &str> {
        self.0.iter().filter(|(_, labels)| labels.is_empty()).map(|(prompt, _)| prompt.as_str())
    }
}

/// Intersection over union of the pixels that a prompt selects ([`SemanticMaps::RELEVANT`]) and the pixels of its classes,
/// for every prompt with visible classes.
///
/// Empty pixels belong to no class, so selecting them lowers the overlap. Prompts without visible classes are skipped,
/// because no selection could be correct.
pub(crate) fn prompt_overlaps(maps: &SemanticMaps, labels: &Labels, prompts: &PromptLabels) -> BTreeMap<String, f64> {
    let overlap = |classes: &[u8], relevancy: &[f32]| {
        let (mut is_visible, mut both, mut either) = (false, 0_usize, 0_usize);
        for (label, &relevancy) in labels.iter().zip(relevancy) {
            let is_class = label.is_some_and(|label| classes.contains(&label));
            let is_selected = relevancy > SemanticMaps::RELEVANT;
            is_visible |= is_class;
            both += usize::from(is_class && is_selected);
            either += usize::from(is_class || is_selected);
        }
        is_visible.then(|| both as f64 / either as f64)
    };
    let planes = prompts.0.iter().zip(&maps.relevancy);
    planes.filter_map(|((prompt, classes), plane)| Some((prompt.clone(), overlap(classes, plane)?))).collect()
}

/// The mean rendered feature per class, over pixels with a coverage of at least one half.
pub(crate) fn class_features(maps: &SemanticMaps, labels: &Labels) -> ClassFeatures {
    let mut sums = ClassFeatures::new();
    for (at, label) in labels.iter().enumerate() {
        let Some(label) = label.filter(|_| maps.alpha[at] >= SemanticMaps::COVERED) else { continue };
        let sum = sums.entry(label).or_insert_with(|| vec![0.0; maps.features.len()]);
        sum.iter_mut().zip(&maps.features).for_each(|(sum, plane)| *sum += f64::from(plane[at]));
    }
    sums.values_mut().for_each(|sum| scale_to_unit(sum));
    sums
}

/// For each image, the mean over its classes of 1 − cos(f, m), where f is the feature of the class in the image and m is the
/// mean of its features over all images; `None` for an image without a class that other images show, too.
///
/// The drift is 0 if every class has constant features, 1 if features are unrelated, and at most 2. The reference is the
/// mean rather than the first image, so that no single image decides. The angle is used because prompts depend only on it.
/// Classes are separate because a mean over the image would change with its content. Features that are equal everywhere
/// have no drift either, so the metric is meaningful only together with the prompt overlap.
pub(crate) fn feature_drifts(images: &[ClassFeatures]) -> Vec<Option<f64>> {
    let mut means = BTreeMap::<u8, (usize, Vec<f64>)>::new();
    for (class, feature) in images.iter().flatten() {
        let (count, sum) = means.entry(*class).or_insert_with(|| (0, vec![0.0; feature.len()]));
        *count += 1;
        sum.iter_mut().zip(feature).for_each(|(sum, value)| *sum += value);
    }
    means.retain(|_, (count, _)| *count > 1);
    means.values_mut().for_each(|(_, sum)| scale_to_unit(sum));
    let drift = |image: &ClassFeatures| {
        let shared = image.iter().filter_map(|(class, feature)| Some((feature, &means.get(class)?.1)));
        let angles: Vec<f64> = shared.map(|(feature, mean)| one_less(dot(feature, mean))).collect();
        (!angles.is_empty()).then(|| angles.iter().sum::<f64>() / angles.len() as f64)
    };
    images.iter().map(drift).collect()
}

/// Scales a vector to unit length. A vanishing vector becomes 0, which is unrelated to every other vector.
fn scale_to_unit(vector: &mut [f64]) {
    // Features are of order 1; a remainder after cancellation has no meaningful direction.
    const VANISHES: f64 = 1e-9;
    let length = dot(vector, vector).sqrt();
    let scale = if length > VANISHES { 1.0 / length } else { 0.0 };
    vector.iter_mut().for_each(|value| *value *= scale);
}

/// 1 − cos, clamped for cosines that exceed 1 by rounding.
fn one_less(cosine: f64) -> f64 {
    if cosine > 1.0 { 0.0 } else { 1.0 - cosine }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two pixels of the background, two of class 1, one of class 2, and an empty one.
    const LABELS: [Option<u8>; 6] = [Some(0), Some(0), Some(1), Some(1), Some(2), None];

    fn prompts() -> PromptLabels {
        let prompts = ["Ball ", "cube", "unicorn"].map(String::from);
        PromptLabels::new(&prompts, ["background", "ball", "cube"].into_iter())
    }

    /// Maps of a perfect model: prompts select their classes, and each class has its own feature.
    fn perfect() -> SemanticMaps {
        let is = |class: u8| LABELS.map(|label| f32::from(u8::from(label == Some(class)))).to_vec();
        SemanticMaps {
            width: 6,
            height: 1,
            alpha: LABELS.map(|label| f32::from(u8::from(label.is_some()))).to_vec(),
            features: vec![is(0), is(1), is(2)],
            relevancy: vec![is(1), is(2), vec![0.0; 6]],
        }
    }

    #[test]
    fn prompts_are_matched_by_name() {
        assert_eq!(prompts().without_class().collect::<Vec<_>>(), ["unicorn"]);
        let twins = PromptLabels::new(&["leg".into()], ["background", "leg", "leg"].into_iter());
        assert_eq!(twins, PromptLabels(vec![("leg".into(), vec![1, 2])]));
    }

    #[test]
    fn correct_selections_overlap_fully_and_shuffled_labels_do_not() {
        let right = prompt_overlaps(&perfect(), &LABELS, &prompts());
        assert_eq!(right, [("Ball ".to_string(), 1.0), ("cube".to_string(), 1.0)].into());
        let mut shuffled = LABELS;
        shuffled.swap(0, 3);
        shuffled.swap(4, 5);
        let wrong = prompt_overlaps(&perfect(), &shuffled, &prompts());
        assert_eq!(wrong, [("Ball ".to_string(), 1.0 / 3.0), ("cube".to_string(), 0.0)].into());
    }

    #[test]
    fn selecting_empty_pixels_lowers_the_overlap() {
        let mut greedy = perfect();
        greedy.relevancy[0] = vec![1.0; 6];
        assert_eq!(prompt_overlaps(&greedy, &LABELS, &prompts())["Ball "], 2.0 / 6.0);
        let without_cube = LABELS.map(|label| label.filter(|label| *label != 2));
        assert!(!prompt_overlaps(&perfect(), &without_cube, &prompts()).contains_key("cube"));
    }

    #[test]
    fn constant_features_do_not_drift_and_flipped_ones_do() {
        let same = vec![class_features(&perfect(), &LABELS); 4];
        assert_eq!(feature_drifts(&same), [Some(0.0); 4]);
        let mut flipped = perfect();
        flipped.features[2].iter_mut().for_each(|value| *value = -*value);
        let flipped = class_features(&flipped, &LABELS);
        let views: Vec<_> = same[..2].iter().chain([&flipped, &flipped]).cloned().collect();
        // The mean of the flipped class vanishes; the other two classes are constant.
        assert_eq!(feature_drifts(&views), [Some(1.0 / 3.0); 4]);
        let late: Vec<_> = same[..3].iter().chain([&flipped]).cloned().collect();
        let drifts = feature_drifts(&late);
        assert_eq!(drifts[0], Some(0.0));
        assert_eq!(drifts[3], Some(2.0 / 3.0), "the image with the flipped class");
    }

    #[test]
    fn a_class_in_a_single_image_has_no_drift() {
        let seen = class_features(&perfect(), &LABELS);
        assert_eq!(feature_drifts(&[seen.clone(), ClassFeatures::new()]), [None, None]);
        let mut hidden = perfect();
        hidden.alpha.fill(0.4);
        assert!(class_features(&hidden, &LABELS).is_empty(), "holes have no features");
        assert_eq!(feature_drifts(&[]), []);
    }
}

//! What renders mean, against labels: the region that a prompt selects, and whether features stay what they are.

use std::collections::BTreeMap;

use rendering::SemanticMaps;

/// The instance label of each pixel; none where nothing is in sight, which belongs to no class.
pub type Labels = [Option<u8>];

/// A mean feature by class, scaled to unit length.
pub type ClassFeatures = BTreeMap<u8, Vec<f64>>;

/// Which labels each prompt stands for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PromptLabels(Vec<(String, Vec<u8>)>);

impl PromptLabels {
    /// A prompt stands for every label with its name, whatever the case of letters and the spaces around it.
    pub fn new<'a>(prompts: &[String], label_names: impl Iterator<Item = &'a str>) -> Self {
        let plain = |text: &str| text.trim().to_lowercase();
        let names: Vec<String> = label_names.map(plain).collect();
        let labels_of = |prompt: &String| {
            let labels = names.iter().zip(0..=u8::MAX).filter(|(name, _)| **name == plain(prompt));
            labels.map(|(_, label)| label).collect()
        };
        Self(prompts.iter().map(|prompt| (prompt.clone(), labels_of(prompt))).collect())
    }

    /// The prompts that no label is called like.
    pub fn without_class(&self) -> impl Iterator<Item = &str> {
        self.0.iter().filter(|(_, labels)| labels.is_empty()).map(|(prompt, _)| prompt.as_str())
    }
}

/// Intersection over union of the pixels that a prompt selects ([`SemanticMaps::RELEVANT`]) and those of its classes, for
/// every prompt in sight.
///
/// A pixel that shows nothing belongs to no class: a prompt that selects it loses. A prompt none of whose classes is in
/// sight is left out, since no answer could be right.
pub fn prompt_overlaps(maps: &SemanticMaps, labels: &Labels, prompts: &PromptLabels) -> BTreeMap<String, f64> {
    let overlap = |classes: &[u8], relevancy: &[f32]| {
        let (mut in_sight, mut both, mut either) = (false, 0_usize, 0_usize);
        for (label, &relevancy) in labels.iter().zip(relevancy) {
            let is_class = label.is_some_and(|label| classes.contains(&label));
            let is_selected = relevancy > SemanticMaps::RELEVANT;
            in_sight |= is_class;
            both += usize::from(is_class && is_selected);
            either += usize::from(is_class || is_selected);
        }
        in_sight.then(|| both as f64 / either as f64)
    };
    let planes = prompts.0.iter().zip(&maps.relevancy);
    planes.filter_map(|((prompt, classes), plane)| Some((prompt.clone(), overlap(classes, plane)?))).collect()
}

/// The mean rendered feature over the pixels of every class that the render covers at least half.
pub fn class_features(maps: &SemanticMaps, labels: &Labels) -> ClassFeatures {
    let mut sums = ClassFeatures::new();
    for (at, label) in labels.iter().enumerate() {
        let Some(label) = label.filter(|_| maps.alpha[at] >= SemanticMaps::COVERED) else { continue };
        let sum = sums.entry(label).or_insert_with(|| vec![0.0; maps.features.len()]);
        sum.iter_mut().zip(&maps.features).for_each(|(sum, plane)| *sum += f64::from(plane[at]));
    }
    sums.values_mut().for_each(|sum| scale_to_unit(sum));
    sums
}

/// Per image: the mean over its classes of 1 − cos(f, m), where f is the class's feature in the image and m the mean of
/// its features over all images; none for an image without a class that other images show too.
///
/// 0 where every class looks the same at every time, 1 where features have nothing in common, 2 at most. Against the mean
/// and not against the first image, so that no image decides; by angle, because only the angle answers a prompt; by
/// class, because a mean over the image would change with what is in sight. Features that are the same everywhere do not
/// drift either: the figure says something only beside the overlap of prompts.
pub fn feature_drifts(images: &[ClassFeatures]) -> Vec<Option<f64>> {
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

/// A vector without direction stays 0: it has nothing in common with any other.
fn scale_to_unit(vector: &mut [f64]) {
    // Features are of order 1; what is left of such values after they cancel has no direction.
    const VANISHES: f64 = 1e-9;
    let length = dot(vector, vector).sqrt();
    let scale = if length > VANISHES { 1.0 / length } else { 0.0 };
    vector.iter_mut().for_each(|value| *value *= scale);
}

/// 1 − cos, without the last bits of a cosine above 1.
fn one_less(cosine: f64) -> f64 {
    if cosine > 1.0 { 0.0 } else { 1.0 - cosine }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two pixels of the background, two of class 1, one of class 2, one that shows nothing.
    const LABELS: [Option<u8>; 6] = [Some(0), Some(0), Some(1), Some(1), Some(2), None];

    fn prompts() -> PromptLabels {
        let prompts = ["Ball ", "cube", "unicorn"].map(String::from);
        PromptLabels::new(&prompts, ["background", "ball", "cube"].into_iter())
    }

    /// Maps of a model that is right everywhere: prompts select their classes, each class has a feature of its own.
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
    fn right_answers_overlap_wholly_and_shuffled_labels_lose() {
        let right = prompt_overlaps(&perfect(), &LABELS, &prompts());
        assert_eq!(right, [("Ball ".to_string(), 1.0), ("cube".to_string(), 1.0)].into());
        let mut shuffled = LABELS;
        shuffled.swap(0, 3);
        shuffled.swap(4, 5);
        let wrong = prompt_overlaps(&perfect(), &shuffled, &prompts());
        assert_eq!(wrong, [("Ball ".to_string(), 1.0 / 3.0), ("cube".to_string(), 0.0)].into());
    }

    #[test]
    fn selecting_nothingness_loses_and_what_is_out_of_sight_does_not_count() {
        let mut greedy = perfect();
        greedy.relevancy[0] = vec![1.0; 6];
        assert_eq!(prompt_overlaps(&greedy, &LABELS, &prompts())["Ball "], 2.0 / 6.0);
        let without_cube = LABELS.map(|label| label.filter(|label| *label != 2));
        assert!(!prompt_overlaps(&perfect(), &without_cube, &prompts()).contains_key("cube"));
    }

    #[test]
    fn features_that_stay_do_not_drift_and_features_that_flip_do() {
        let same = vec![class_features(&perfect(), &LABELS); 4];
        assert_eq!(feature_drifts(&same), [Some(0.0); 4]);
        let mut flipped = perfect();
        flipped.features[2].iter_mut().for_each(|value| *value = -*value);
        let flipped = class_features(&flipped, &LABELS);
        let views: Vec<_> = same[..2].iter().chain([&flipped, &flipped]).cloned().collect();
        // The class that flips has no mean direction left; two of three classes stay.
        assert_eq!(feature_drifts(&views), [Some(1.0 / 3.0); 4]);
        let late: Vec<_> = same[..3].iter().chain([&flipped]).cloned().collect();
        let drifts = feature_drifts(&late);
        assert_eq!(drifts[0], Some(0.0));
        assert_eq!(drifts[3], Some(2.0 / 3.0), "the odd one out");
    }

    #[test]
    fn a_class_that_only_one_image_shows_has_no_drift() {
        let seen = class_features(&perfect(), &LABELS);
        assert_eq!(feature_drifts(&[seen.clone(), ClassFeatures::new()]), [None, None]);
        let mut hidden = perfect();
        hidden.alpha.fill(0.4);
        assert!(class_features(&hidden, &LABELS).is_empty(), "a hole has no feature");
        assert_eq!(feature_drifts(&[]), []);
    }
}

//! Answers to prompts that need no model: all visible pixels, or the pixels that show the class in other images.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::language::{Labels, PromptLabels};

/// Intersection over union of answers that need no model with the pixels of a prompt's classes. Both know which pixels are
/// empty and select none of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrivialOverlap {
    /// Selecting every pixel that is not empty; selecting none would score 0.
    pub constant: f64,
    /// Selecting the pixels that show the class in at least a certain number of the *other* images: the number that is best
    /// on average over the images. Never below [`TrivialOverlap::constant`] on average, because that number may be 0.
    pub spatial_prior: f64,
}

impl TrivialOverlap {
    /// The mean; `None` for an empty sequence.
    pub(crate) fn mean(overlaps: &[Self]) -> Option<Self> {
        let count = overlaps.len() as f64;
        let mean = |value: fn(&Self) -> f64| overlaps.iter().map(value).sum::<f64>() / count;
        (!overlaps.is_empty()).then(|| Self {
            constant: mean(|overlap| overlap.constant),
            spatial_prior: mean(|overlap| overlap.spatial_prior),
        })
    }
}

/// The number of images that show the classes of each prompt at each pixel.
pub(crate) struct ClassCounts {
    /// Per prompt and pixel.
    counts: Vec<Vec<u32>>,
    images: u32,
}

/// Overlaps of one prompt in one image, by the least number of other images that must show the class at a pixel.
type ByThreshold = Vec<f64>;

impl ClassCounts {
    /// No images yet.
    pub(crate) fn new(prompts: &PromptLabels) -> Self {
        Self { counts: vec![Vec::new(); prompts.len()], images: 0 }
    }

    /// Adds an image; all images have the same size.
    pub(crate) fn add(&mut self, labels: &Labels, prompts: &PromptLabels) {
        self.images += 1;
        for (prompt, counts) in self.counts.iter_mut().enumerate() {
            counts.resize(labels.len(), 0);
            counts.iter_mut().zip(labels).for_each(|(count, &label)| *count += u32::from(prompts.shows(prompt, label)));
        }
    }

    /// The overlaps in an image that was added, per prompt; none for prompts without visible classes.
    pub(crate) fn overlaps(&self, labels: &Labels, prompts: &PromptLabels) -> Vec<Option<ByThreshold>> {
        (0..self.counts.len()).map(|prompt| self.overlap(prompt, labels, prompts)).collect()
    }

    fn overlap(&self, prompt: usize, labels: &Labels, prompts: &PromptLabels) -> Option<ByThreshold> {
        let (mut of_class, mut of_all) = (vec![0_usize; self.images as usize], vec![0_usize; self.images as usize]);
        for (&label, &count) in labels.iter().zip(&self.counts[prompt]) {
            let is_class = prompts.shows(prompt, label);
            let others = (count - u32::from(is_class)) as usize;
            of_class[others] += usize::from(is_class);
            of_all[others] += usize::from(label.is_some());
        }
        let class_pixels: usize = of_class.iter().sum();
        let (mut both, mut selected) = (0, 0);
        // From the largest number of other images down to zero.
        let overlap = |(hits, pixels): (&usize, &usize)| {
            both += hits;
            selected += pixels;
            both as f64 / (class_pixels + selected - both) as f64
        };
        let mut overlaps: Vec<f64> = of_class.iter().zip(&of_all).rev().map(overlap).collect();
        overlaps.reverse();
        (class_pixels > 0).then_some(overlaps)
    }
}

/// The overlaps of trivial answers per image and prompt, from the overlaps of every image and the names of the prompts.
pub(crate) fn trivial_overlaps(
    images: &[Vec<Option<ByThreshold>>],
    names: &[String],
) -> Vec<BTreeMap<String, TrivialOverlap>> {
    let mut found = vec![BTreeMap::new(); images.len()];
    for (prompt, name) in names.iter().enumerate() {
        let visible =
            || images.iter().enumerate().filter_map(|(image, prompts)| Some((image, prompts.get(prompt)?.as_ref()?)));
        let thresholds = visible().map(|(_, overlaps)| overlaps.len()).min().unwrap_or(0);
        let sum = |threshold: &usize| visible().map(|(_, overlaps)| overlaps[*threshold]).sum::<f64>();
        let Some(best) = (0..thresholds).max_by(|a, b| sum(a).total_cmp(&sum(b))) else { continue };
        for (image, overlaps) in visible() {
            let overlap = TrivialOverlap { constant: overlaps[0], spatial_prior: overlaps[best] };
            found[image].insert(name.clone(), overlap);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The overlaps of images of four pixels with labels of a ball (1) on a background (0) and empty pixels.
    fn of(images: &[[Option<u8>; 4]]) -> Vec<BTreeMap<String, TrivialOverlap>> {
        let names = ["ball".to_owned(), "unicorn".to_owned()];
        let prompts = PromptLabels::new(&names, ["background", "ball"].into_iter());
        let mut counts = ClassCounts::new(&prompts);
        images.iter().for_each(|labels| counts.add(labels, &prompts));
        let overlaps: Vec<_> = images.iter().map(|labels| counts.overlaps(labels, &prompts)).collect();
        trivial_overlaps(&overlaps, &names)
    }

    #[test]
    fn a_class_that_stands_still_is_found_by_its_place() {
        let still = [Some(1), Some(0), Some(0), None];
        let found = of(&[still; 3]);
        for image in &found {
            assert_eq!(image["ball"], TrivialOverlap { constant: 1.0 / 3.0, spatial_prior: 1.0 });
            assert!(!image.contains_key("unicorn"));
        }
    }

    #[test]
    fn a_class_that_is_never_twice_at_a_place_has_no_useful_prior() {
        let at = |place: usize| std::array::from_fn(|pixel| Some(u8::from(pixel == place)));
        for image in of(&[at(0), at(1), at(2)]) {
            assert_eq!(image["ball"], TrivialOverlap { constant: 0.25, spatial_prior: 0.25 });
        }
    }

    #[test]
    fn an_image_is_left_out_of_its_own_prior() {
        let found = of(&[[Some(1), Some(0), Some(0), Some(0)]]);
        assert_eq!(found[0]["ball"], TrivialOverlap { constant: 0.25, spatial_prior: 0.25 });
        // A place that most images show, but not all: the image that does not show it scores lower.
        let ball = [Some(1), Some(0), Some(0), Some(0)];
        let away = [Some(0), Some(1), Some(0), Some(0)];
        let found = of(&[ball, ball, ball, away]);
        assert_eq!(found[0]["ball"].spatial_prior, 1.0);
        assert_eq!(found[3]["ball"].spatial_prior, 0.0);
    }
}

//! Metrics of the image sequence of one camera.

use crate::image_file::Image;

/// Mean over pixels and channels of |(r₁ − t₁) − (r₀ − t₀)|: the change of the error between consecutive images of a fixed
/// camera. A constant error does not flicker; the value is 0 for a video that equals its ground truth.
pub(crate) fn residual_change(before: [&Image; 2], after: [&Image; 2]) -> f64 {
    let change = |c: usize| {
        let errors = |[render, truth]: [&Image; 2]| -> Vec<f64> {
            render.planes[c].iter().zip(&truth.planes[c]).map(|(render, truth)| render - truth).collect()
        };
        errors(after).iter().zip(errors(before)).map(|(after, before)| (after - before).abs()).sum::<f64>()
    };
    (0..3).map(change).sum::<f64>() / (3 * after[0].width * after[0].height) as f64
}

/// For each image after the first, the mean of its cosines (at least 0) with the previous and with the first image, from
/// one feature vector per image (Huang et al., "VBench", CVPR 2024: subject and background consistency).
pub(crate) fn consistencies(features: &[Vec<f64>]) -> Vec<f64> {
    let similar = |a: &[f64], b: &[f64]| cosine(a, b).max(0.0);
    let of_pair = |pair: &[Vec<f64>]| 0.5 * (similar(&pair[1], &pair[0]) + similar(&pair[1], &features[0]));
    features.windows(2).map(of_pair).collect()
}

/// tOF: mean length of the difference of two optical flows in pixels (Chu et al., "Learning temporal coherence via
/// self-supervision", 2020; lengths as in the authors' code, while the paper has a sum of magnitudes).
pub(crate) fn flow_difference(render: &[f64], truth: &[f64]) -> f64 {
    let length = |(render, truth): (&[f64; 2], &[f64; 2])| (render[0] - truth[0]).hypot(render[1] - truth[1]);
    let (render, truth) = (render.as_chunks().0, truth.as_chunks().0);
    render.iter().zip(truth).map(length).sum::<f64>() / render.len() as f64
}

/// The cosine of two vectors; 0 if either is zero.
fn cosine(a: &[f64], b: &[f64]) -> f64 {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let lengths = (dot(a, a) * dot(b, b)).sqrt();
    if lengths > 0.0 { dot(a, b) / lengths } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(value: f64) -> Image {
        Image { width: 2, height: 1, planes: [0, 1, 2].map(|_| vec![value; 2]) }
    }

    #[test]
    fn only_a_changing_error_flickers() {
        let (truth, later_truth) = (grey(0.25), grey(0.75));
        assert_eq!(residual_change([&grey(0.5), &truth], [&grey(1.0), &later_truth]), 0.0);
        assert_eq!(residual_change([&grey(0.5), &truth], [&grey(0.5), &later_truth]), 0.5);
        assert_eq!(residual_change([&truth, &truth], [&later_truth, &later_truth]), 0.0);
    }

    /// Compares with the value of an independent implementation; scaled features must give equal values.
    #[test]
    fn consistency_equals_an_independent_value() {
        let features = [[1.0, 0.0, 0.0], [0.8, 0.6, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]].map(Vec::from);
        let found = consistencies(&features);
        assert!((found.iter().sum::<f64>() / 3.0 - 0.3666666666666667).abs() <= 1e-12, "{found:?}");
        let longer: Vec<Vec<f64>> = features.iter().map(|feature| feature.iter().map(|v| 3.0 * v).collect()).collect();
        assert!(
            consistencies(&longer).iter().zip(&found).all(|(a, b)| (a - b).abs() <= 1e-12),
            "the length of features has no effect"
        );
        assert!(consistencies(&features[..1]).is_empty() && consistencies(&[]).is_empty());
        assert_eq!(consistencies(&[vec![0.0; 3], vec![1.0, 0.0, 0.0]]), [0.0]);
    }
}

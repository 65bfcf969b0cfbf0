//! Exact features from instance labels: ground truth for consumers of CLIP features.

use engine::{Failure, FailureKind};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use scene::{Capture, FloatImage, LabelMap, ResizeFilter, View};

use crate::Params;
use crate::artifact::TokenGrid;

/// The classes of a capture with one embedding each.
pub(crate) struct Vocabulary {
    /// The background, then the class names of the capture; label k has index k.
    pub(crate) prompts: Vec<String>,
    /// [P, F] matrix with orthonormal rows.
    pub(crate) embeddings: Vec<f32>,
    dimension: usize,
}

impl Vocabulary {
    /// Draws one random direction per class, orthogonal to all others.
    pub(crate) fn of(capture: &Capture, params: &Params) -> anyhow::Result<Self> {
        let prompts: Vec<String> = capture.label_names().map(str::to_owned).collect();
        if prompts.len() > params.dimension {
            let (classes, dimension) = (prompts.len(), params.dimension);
            let message = format!("{classes} classes do not fit into orthogonal embeddings of dimension {dimension}");
            let hint = format!("set dimension to at least {classes}");
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).into());
        }
        let embeddings = orthonormal_rows(prompts.len(), params.dimension, params.seed);
        Ok(Self { prompts, embeddings, dimension: params.dimension })
    }

    /// The tokens of one view: the mean class embedding over the pixels of a cell, with partly covered pixels weighted
    /// by their share. The dot product of a token and an embedding is thus the share of the cell that shows the class.
    pub(crate) fn tokens(&self, capture: &Capture, view: &View, grid: u32) -> anyhow::Result<TokenGrid> {
        let Some(labels) = capture.load_mask(view)? else {
            let message = format!("view {} has no instance labels", view.name);
            let hint = "add \"masks\" to `truths` of scene-synthesis";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).into());
        };
        let [rows, columns] = grid_size(labels.width, labels.height, grid);
        let shares = self.one_hot(&labels).resized(columns, rows, ResizeFilter::Area);
        let classes = self.prompts.len();
        let mut values = vec![0.0; rows as usize * columns as usize * self.dimension];
        for (token, shares) in values.chunks_exact_mut(self.dimension).zip(shares.values.chunks_exact(classes)) {
            for (embedding, share) in self.embeddings.chunks_exact(self.dimension).zip(shares) {
                token.iter_mut().zip(embedding).for_each(|(sum, value)| *sum += share * value);
            }
        }
        Ok(TokenGrid { rows: rows as usize, columns: columns as usize, values })
    }

    /// One-hot classes of pixels, [H, W, P].
    fn one_hot(&self, labels: &LabelMap) -> FloatImage {
        let classes = self.prompts.len();
        let mut values = vec![0.0; labels.labels.len() * classes];
        for (pixel, label) in labels.labels.iter().enumerate() {
            values[pixel * classes + usize::from(*label)] = 1.0;
        }
        FloatImage { width: labels.width, height: labels.height, channels: classes, values }
    }
}

/// Rows and columns of a grid with `longest` tokens along the longer side of an image; no token is smaller than a
/// pixel.
fn grid_size(width: u32, height: u32, longest: u32) -> [u32; 2] {
    let side = width.max(height);
    let longest = longest.min(side);
    let tokens = |pixels: u32| (f64::from(pixels * longest) / f64::from(side)).round().max(1.0) as u32;
    [tokens(height), tokens(width)]
}

/// Random orthonormal rows: Gram–Schmidt on normal deviates in f64, repeated once against rounding errors.
fn orthonormal_rows(count: usize, dimension: usize, seed: u64) -> Vec<f32> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut rows: Vec<Vec<f64>> = Vec::with_capacity(count);
    for _ in 0..count {
        let mut row: Vec<f64> = (0..dimension).map(|_| StandardNormal.sample(&mut random)).collect();
        for _ in 0..2 {
            for other in &rows {
                let along: f64 = row.iter().zip(other).map(|(a, b)| a * b).sum();
                row.iter_mut().zip(other).for_each(|(value, other)| *value -= along * other);
            }
            let norm = row.iter().map(|value| value * value).sum::<f64>().sqrt();
            row.iter_mut().for_each(|value| *value /= norm);
        }
        rows.push(row);
    }
    rows.into_iter().flatten().map(|value| value as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn embeddings_are_orthonormal_and_follow_the_seed() {
        for (count, dimension) in [(1, 1), (5, 64), (16, 16)] {
            let rows = orthonormal_rows(count, dimension, 3);
            for (i, a) in rows.chunks_exact(dimension).enumerate() {
                for (j, b) in rows.chunks_exact(dimension).enumerate() {
                    let dot: f64 = a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
                    let error = (dot - f64::from(u8::from(i == j))).abs();
                    assert!(error <= 1e-6, "rows {i} and {j} of {count}: {dot}");
                }
            }
        }
        assert_eq!(orthonormal_rows(3, 8, 1), orthonormal_rows(3, 8, 1));
        assert_ne!(orthonormal_rows(3, 8, 1), orthonormal_rows(3, 8, 2));
    }

    #[test]
    fn grids_keep_the_aspect_ratio_and_cover_pixels() {
        assert_eq!(grid_size(200, 200, 32), [32, 32]);
        assert_eq!(grid_size(1920, 1072, 32), [18, 32]);
        assert_eq!(grid_size(24, 16, 32), [16, 24]);
        assert_eq!(grid_size(1000, 2, 10), [1, 10]);
    }
}

//! The layouts in which estimators write visual tokens.
//!
//! | layout | written by |
//! |---|---|
//! | [rows, columns, F] | this project's own layout |
//! | [F, rows, columns] | feature maps, e.g. `get_intermediate_layers(reshape=True)` of DINOv2 |
//! | [tokens, F], row by row, with or without class and register tokens in front | `last_hidden_state` of CLIP and DINOv2 in transformers, `x_norm_patchtokens` of DINOv2 |
//! | segments: `<view>_s.npy` [levels, H, W] and `<view>_f.npy` [segments, F] | `preprocess.py` of LangSplat |
//!
//! Each may have a leading batch axis of length 1.

use std::path::Path;

use crate::array_file::wrong_shape;
use crate::artifact::TokenGrid;

/// Numbers of class and register tokens in front of the patches: none; the class; the class and four registers.
const LEADING: [usize; 3] = [0, 1, 5];
/// The largest ratio between the proportions of the grid and those of the image, unless the grid is square: the rounding to
/// whole patches.
const MAX_STRETCH: f64 = 1.06;
/// Index of the level `whole` of LangSplat's segments, after `default`, `subpart` and `part`.
const WHOLE: usize = 3;

/// The tokens of an array of one of the layouts above, and their dimension F. `dimension` is that of the text embeddings, if
/// there are any; `size` is the width and height of the image.
pub(crate) fn tokens_of(
    shape: &[usize],
    values: Vec<f32>,
    dimension: Option<usize>,
    size: [u32; 2],
    path: &Path,
) -> anyhow::Result<(TokenGrid, usize)> {
    let expected = "[rows, columns, F], [F, rows, columns] or [tokens, F]";
    let shape = without_batch(shape);
    match *shape {
        [rows, columns, width] if is_last(shape, dimension) => Ok((TokenGrid { rows, columns, values }, width)),
        [width, rows, columns] => {
            let values = transposed(&values, width, rows * columns);
            Ok((TokenGrid { rows, columns, values }, width))
        }
        [count, width] => {
            let Some((skipped, [rows, columns])) = grid_of(count, size) else {
                return Err(wrong_shape(
                    shape,
                    &format!("{expected} with a number of tokens that fits the image"),
                    path,
                ));
            };
            Ok((TokenGrid { rows, columns, values: values[skipped * width..].to_vec() }, width))
        }
        _ => Err(wrong_shape(shape, expected, path)),
    }
}

/// The tokens of LangSplat's segments: each cell of a grid gets the mean feature of its pixels' segments on the level
/// `whole`; pixels without a segment (−1) are ignored. `None` where the array is not [4, H, W].
pub(crate) fn tokens_of_segments(
    (shape, segments): (&[usize], &[f32]),
    features: &[f32],
    width: usize,
    grid: usize,
) -> Option<TokenGrid> {
    let &[levels, height, columns_px] = shape else { return None };
    let level = segments.chunks_exact(height * columns_px).nth(WHOLE.min(levels.checked_sub(1)?))?;
    let longer = height.max(columns_px).max(1);
    let cells = |pixels: usize| (pixels * grid.min(longer)).div_ceil(longer);
    let (rows, columns) = (cells(height), cells(columns_px));
    let (mut values, mut counts) = (vec![0.0; rows * columns * width], vec![0_u32; rows * columns]);
    for (at, &segment) in level.iter().enumerate() {
        let cell = (at / columns_px * rows / height) * columns + at % columns_px * columns / columns_px;
        let feature = (segment >= 0.0).then(|| features.chunks_exact(width).nth(segment as usize)).flatten();
        let Some(feature) = feature else { continue };
        counts[cell] += 1;
        values[cell * width..][..width].iter_mut().zip(feature).for_each(|(sum, value)| *sum += value);
    }
    // Cells without a segment get the mean of all others: no token may be zero, and the mean carries no specific meaning.
    let total: u32 = counts.iter().sum();
    let mean: Vec<f32> =
        (0..width).map(|at| values.iter().skip(at).step_by(width).sum::<f32>() / total.max(1) as f32).collect();
    for (token, count) in values.chunks_exact_mut(width).zip(counts) {
        match count {
            0 => token.copy_from_slice(&mean),
            count => token.iter_mut().for_each(|value| *value /= count as f32),
        }
    }
    Some(TokenGrid { rows, columns, values })
}

/// The shape without a leading batch axis of length 1. The first of three axes is a batch axis only if the second holds
/// at least 2 × 2 patches; otherwise it is a single row.
fn without_batch(shape: &[usize]) -> &[usize] {
    match shape {
        [1, rest @ ..] if rest.len() == 3 || rest.len() == 2 && rest[0] >= 4 => rest,
        _ => shape,
    }
}

/// Whether the last of three axes holds the features: it has the dimension of the text, or without text it is the longest.
fn is_last(shape: &[usize], dimension: Option<usize>) -> bool {
    match dimension {
        // A shape in which no axis fits is read in the project's own layout, so that the error names its dimension.
        Some(dimension) => shape[2] == dimension || shape[0] != dimension,
        None => shape[2] >= shape[0],
    }
}

/// [width, count] as [count, width].
fn transposed(values: &[f32], width: usize, count: usize) -> Vec<f32> {
    (0..count).flat_map(|at| (0..width).map(move |channel| values[channel * count + at])).collect()
}

/// The number of leading tokens that are not patches, and rows and columns of the patches: the grid whose patches are
/// nearest to squares in the image.
fn grid_of(count: usize, [width, height]: [u32; 2]) -> Option<(usize, [usize; 2])> {
    let aspect = f64::from(width) / f64::from(height);
    let grids = LEADING.iter().filter_map(|&skipped| Some((skipped, count.checked_sub(skipped)?))).flat_map(
        |(skipped, patches)| {
            let divisors = (1..=patches).filter(move |rows| patches.is_multiple_of(*rows));
            divisors.map(move |rows| (skipped, [rows, patches / rows]))
        },
    );
    let stretch = |[rows, columns]: [usize; 2]| (columns as f64 / rows as f64 / aspect).ln().abs();
    let squarest = |(_, [rows, columns]): &(usize, [usize; 2])| (*columns as f64 / *rows as f64).ln().abs();
    // A square grid is the most common one, because encoders resize or crop images to squares.
    let best = grids.min_by(|a, b| squarest(a).min(stretch(a.1)).total_cmp(&squarest(b).min(stretch(b.1))))?;
    (squarest(&best).min(stretch(best.1)) <= MAX_STRETCH.ln()).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(shape: &[usize], dimension: Option<usize>, size: [u32; 2]) -> anyhow::Result<(TokenGrid, usize)> {
        let values = (0..shape.iter().product()).map(|at: usize| at as f32).collect();
        tokens_of(shape, values, dimension, size, Path::new("a.npy"))
    }

    fn grid(shape: &[usize], dimension: Option<usize>, size: [u32; 2]) -> ([usize; 3], f32) {
        let (tokens, width) = of(shape, dimension, size).unwrap();
        assert_eq!(tokens.values.len(), tokens.rows * tokens.columns * width);
        ([tokens.rows, tokens.columns, width], tokens.values[1])
    }

    #[test]
    fn hidden_states_lose_their_class_and_register_tokens() {
        // CLIP ViT-B/16 at 224 px: 1 + 14² tokens. The first value that counts is that of the second token.
        assert_eq!(grid(&[1, 197, 512], Some(512), [800, 800]), ([14, 14, 512], 513.0));
        // DINOv2 ViT-S/14 at 518 px: patches alone, with the class, with the class and four registers.
        assert_eq!(grid(&[1369, 384], None, [800, 600]), ([37, 37, 384], 1.0));
        assert_eq!(grid(&[1, 1370, 384], None, [800, 600]), ([37, 37, 384], 385.0));
        assert_eq!(grid(&[1, 1374, 384], None, [800, 600]).0, [37, 37, 384]);
        // An encoder that keeps the proportions: 54 × 96 patches of a 16:9 image.
        assert_eq!(grid(&[54 * 96, 384], None, [1344, 756]).0, [54, 96, 384]);
        assert!(of(&[1009, 384], None, [800, 800]).unwrap_err().to_string().contains("fits the image"));
    }

    #[test]
    fn feature_maps_may_have_their_channels_first() {
        assert_eq!(grid(&[16, 24, 384], None, [800, 600]), ([16, 24, 384], 1.0));
        // The second value is that of the second channel of the first token.
        assert_eq!(grid(&[1, 384, 16, 24], None, [800, 600]), ([16, 24, 384], 384.0));
        assert_eq!(grid(&[5, 16, 24], Some(5), [800, 600]), ([16, 24, 5], 384.0));
        assert_eq!(grid(&[16, 24, 5], Some(5), [800, 600]), ([16, 24, 5], 1.0));
    }

    #[test]
    fn segments_become_the_means_of_their_cells() {
        // Four levels of 2 × 4 pixels, of which the last one counts; a cell of two segments, and a cell without any.
        let whole = [0.0, 0.0, 1.0, 1.0, 0.0, 1.0, -1.0, -1.0];
        let segments: Vec<f32> = [[-1.0; 8], [-1.0; 8], [-1.0; 8], whole].concat();
        let features = [1.0, 0.0, 0.0, 1.0];
        let tokens = tokens_of_segments((&[4, 2, 4], &segments), &features, 2, 2).unwrap();
        assert_eq!((tokens.rows, tokens.columns), (1, 2));
        assert_eq!(tokens.values, [0.75, 0.25, 0.0, 1.0]);
        let empty = tokens_of_segments((&[1, 1, 2], &[-1.0, 0.0]), &features, 2, 2).unwrap();
        assert_eq!(empty.values, [1.0, 0.0, 1.0, 0.0]);
    }
}

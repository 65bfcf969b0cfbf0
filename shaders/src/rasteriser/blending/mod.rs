//! Blending of projected splats, front to back, into an image.
//!
//! At a pixel with distance (dx, dy) = mean − pixel centre: σ = ½(A(dx + k·dy)² + m·dy²), alpha = min(cap, opacity·e^(−σ)),
//! skipped where σ > cutoff; weight wᵢ = alphaᵢ·Tᵢ, Tᵢ₊₁ = Tᵢ(1 − alphaᵢ); the first splat that would leave T ≤ stop is not
//! blended and ends the pixel (Kerbl et al. 2023). Colour = Σ wᵢcᵢ + T·background, depth = Σ wᵢzᵢ, features = Σ wᵢfᵢ,
//! opacity of the image = 1 − T.
//!
//! The backward pass replays the forward pass with one scalar per pixel, Σⱼ wⱼφⱼ over the splats behind, with
//! φ = Σ value·gradient over the channels, and writes one row of sums per (tile, splat), in moments of (e, dy) with
//! e = dx + k·dy. The rows of a splat are added in a fixed order: the result does not depend on scheduling.

mod cpu;
mod gpu;
mod images;
mod kernel;
mod lanes;
mod packed;
mod reference;
#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use crate::gpu::Gpu;
use crate::rasteriser::binning::{Lists, TILE};
use crate::rasteriser::isa::Isa;
use crate::rasteriser::projection::ProjectedVars;
use crate::rasteriser::settings::RasterSettings;
use crate::tape::chunks::{CHUNK, chunked, chunked_arrays, chunked_with};
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};
pub use gpu::PixelSums;
use images::PartOfImage;
use packed::{PackedSplats, Tile};

/// Pixels of a tile, and so the length of one of its planes.
const PIXELS: usize = TILE * TILE;
/// Splats per parallel chunk: tens of microseconds.
const SPLATS_PER_CHUNK: usize = 1024;
/// Where a row of sums holds Σ v·(1, e, e², e·dy, dy, dy²) with v the gradient of σ.
const ROW_MOMENTS: usize = 0;
/// Where a row of sums holds the gradients of the three colours, followed by those of the extras.
const ROW_COLORS: usize = 6;
/// Images that a render writes: transmittance, colour, alpha, depth and features.
const IMAGES: usize = 5;
/// The output of [`blend`] that is alpha.
const ALPHA: usize = 1;

/// Images of [`blend`].
#[derive(Clone, Debug)]
pub struct Blended {
    /// [H, W, 3].
    pub color: Var,
    /// [H, W]: 1 − transmittance.
    pub alpha: Var,
    /// [H, W]: Σ wᵢzᵢ, not divided by alpha; present if the settings request it.
    pub depth: Option<Var>,
    /// [H, W, F]: Σ wᵢfᵢ.
    pub features: Option<Var>,
    /// (Pixel, splat) pairs that were blended; not counted on a GPU.
    pub(crate) blended_count: Option<u64>,
}

/// Blends projected splats and, with the same weights, their features [N, F].
pub fn blend<T: Real>(
    tape: &mut Tape<T>,
    projected: &ProjectedVars,
    features: Option<Var>,
    lists: &Arc<Lists>,
    settings: &RasterSettings,
) -> Blended {
    let ProjectedVars { means2d, conics, depths, opacities, colors, cutoffs } = *projected;
    let mut inputs = vec![means2d, conics, opacities, colors, cutoffs];
    inputs.extend(settings.depth.then_some(depths));
    inputs.extend(features);
    let feature_count = features.map_or(0, |features| tape.value(features).row_len());
    assert!(features.is_none() || feature_count > 0, "features need at least one channel");
    let blended_count = Arc::new(AtomicU64::new(0));
    let op = Blend {
        lists: lists.clone(),
        constants: Constants::<T>::new(settings),
        depth_count: usize::from(settings.depth),
        feature_count,
        isa: (!settings.smooth_cutoff).then_some(settings.isa),
        splats: RankedSplats::default(),
        transmittance: Vec::new(),
        kept: None,
        blended_count: blended_count.clone(),
    };
    let mut outputs = tape.apply(op, &inputs).into_iter();
    let mut next = || outputs.next().expect("one output per kind of channel");
    Blended {
        color: next(),
        alpha: next(),
        depth: settings.depth.then(&mut next),
        features: features.map(|_| next()),
        blended_count: matches!(**lists, Lists::Host(_)).then(|| blended_count.load(Ordering::Relaxed)),
    }
}

/// Settings rounded to the scalar type.
struct Constants<T> {
    alpha_cap: T,
    stop: T,
    background: [T; 3],
    smooth_cutoff: bool,
}

impl<T: Real> Constants<T> {
    fn new(settings: &RasterSettings) -> Self {
        Self {
            alpha_cap: T::from_f64(settings.alpha_cap),
            stop: T::from_f64(settings.transmittance_stop),
            background: settings.background.map(|value| T::from_f64(value.into())),
            smooth_cutoff: settings.smooth_cutoff,
        }
    }

    /// The factor by which an alpha near the threshold is reduced, and its derivative: 1, or for finite differences a smooth
    /// step (3t² − 2t³) from ½ to 1½ of the threshold.
    fn fade(&self, alpha: T) -> (T, T) {
        let threshold = T::from_f64(RasterSettings::ALPHA_THRESHOLD);
        let t = (alpha / threshold - T::from_f64(0.5)).max(T::ZERO).min(T::ONE);
        if !self.smooth_cutoff || t >= T::ONE {
            return (T::ONE, T::ZERO);
        }
        let (two, three) = (T::from_f64(2.0), T::from_f64(3.0));
        (t * t * (three - two * t), (two * three) * t * (T::ONE - t) / threshold)
    }
}

/// The splats that meet the image, front to back, each in one place.
#[derive(Default)]
struct RankedSplats<T> {
    /// Mean (2), conic (3), opacity, cutoff, colour (3).
    records: Vec<[T; 10]>,
    /// [ranks, E]: depth if it is rendered, then features.
    extras: Vec<T>,
    extra_count: usize,
}

impl<T: Real> RankedSplats<T> {
    fn new(inputs: &[&Tensor<T>], order: &[u32]) -> Self {
        let &[means2d, conics, opacities, colors, cutoffs, ref extras @ ..] = inputs else {
            unreachable!("five inputs")
        };
        let (means2d, conics) = (means2d.as_slice().as_chunks().0, conics.as_slice().as_chunks().0);
        let colors = colors.as_slice().as_chunks().0;
        let record = |&splat: &u32| {
            let splat = splat as usize;
            let ([u, v], [a, k, m]): ([T; 2], [T; 3]) = (means2d[splat], conics[splat]);
            let [r, g, b]: [T; 3] = colors[splat];
            [u, v, a, k, m, opacities.as_slice()[splat], cutoffs.as_slice()[splat], r, g, b]
        };
        let extra_count: usize = extras.iter().map(|extra| extra.row_len()).sum();
        let extras_of = |first: usize, rows: &mut [T]| {
            for (row, &splat) in rows.chunks_exact_mut(extra_count).zip(&order[first / extra_count..]) {
                let mut rest = row;
                for extra in extras {
                    let values;
                    (values, rest) = rest.split_at_mut(extra.row_len());
                    values.copy_from_slice(extra.row(splat as usize));
                }
            }
        };
        let extras = match extra_count {
            0 => Vec::new(),
            _ => chunked(order.len() * extra_count, SPLATS_PER_CHUNK * extra_count, extras_of),
        };
        Self { records: order.par_iter().with_min_len(SPLATS_PER_CHUNK).map(record).collect(), extras, extra_count }
    }

    /// Colour and extras of a splat.
    fn channels(&self, rank: usize) -> impl Iterator<Item = T> {
        let [.., r, g, b] = self.records[rank];
        [r, g, b].into_iter().chain(self.extras[rank * self.extra_count..][..self.extra_count].iter().copied())
    }
}

struct Blend<T> {
    lists: Arc<Lists>,
    constants: Constants<T>,
    depth_count: usize,
    feature_count: usize,
    /// The instructions of the fast body, or `None` for the reference.
    isa: Option<Isa>,
    splats: RankedSplats<T>,
    /// [H, W], after the last splat.
    transmittance: Vec<T>,
    /// Values of the forward pass on a GPU.
    kept: Option<gpu::Kept>,
    blended_count: Arc<AtomicU64>,
}

/// The code that blends one tile.
enum Body<'a, T> {
    Fast(PackedSplats<'a>),
    Reference(&'a RankedSplats<T>, &'a Constants<T>),
}

impl<T: Real> Body<'_, T> {
    fn forward(&self, tile: &Tile, planes: &mut [T]) -> u64 {
        match (self, T::as_f32_mut(planes)) {
            (Self::Fast(splats), Some(planes)) => splats.forward(tile, planes),
            (Self::Reference(splats, constants), _) => reference::forward(splats, constants, tile, planes),
            (Self::Fast(_), None) => unreachable!("the fast body is for f32"),
        }
    }

    fn backward(&self, tile: &Tile, planes: &mut [T], rows: &mut [T]) {
        match (self, T::as_f32_mut(planes), T::as_f32_mut(rows)) {
            (Self::Fast(splats), Some(planes), Some(rows)) => splats.backward(tile, planes, rows),
            (Self::Reference(splats, constants), ..) => reference::backward(splats, constants, tile, planes, rows),
            (Self::Fast(_), ..) => unreachable!("the fast body is for f32"),
        }
    }
}

impl<T: Real> Blend<T> {
    fn extra_count(&self) -> usize {
        self.depth_count + self.feature_count
    }

    fn body(&self) -> Body<'_, T> {
        let fast = self.isa.and_then(|isa| PackedSplats::new(&self.splats, &self.constants, isa));
        fast.map_or(Body::Reference(&self.splats, &self.constants), Body::Fast)
    }

    fn tile(&self, index: usize) -> Tile<'_> {
        let grid = self.lists.on_host().grid;
        Tile { origin: grid.origin(index), extent: grid.extent(index), ranks: self.lists.on_host().tile(index) }
    }

    /// The number of elements in the planes of a tile: transmittance, three colours, extras.
    fn planes_len(&self) -> usize {
        (4 + self.extra_count()) * PIXELS
    }

    /// Blends the row of tiles from `first_tile` into its part of the images: transmittance, colour, alpha, depth and features,
    /// where the last two may be empty. Returns the number of blended (pixel, splat) pairs.
    ///
    /// The planes of these tiles are still in the cache when they are copied to the images.
    fn blend_row(&self, body: &Body<T>, first_tile: usize, images: [&mut [T]; IMAGES]) -> u64 {
        let grid = self.lists.on_host().grid;
        let planes_len = self.planes_len();
        let blend = |first: usize, planes: &mut [T]| body.forward(&self.tile(first_tile + first / planes_len), planes);
        let (mut planes, blended_counts) = chunked_with(grid.columns() * planes_len, planes_len, blend);
        let [transmittances, colors, alphas, depths, features] = images;
        for (index, planes) in (first_tile..).zip(planes.chunks_exact_mut(planes_len)) {
            let tile = self.tile(index);
            let (left, rest) = planes.split_at_mut(PIXELS);
            let (color, rest) = rest.split_at_mut(3 * PIXELS);
            let (depth, feature) = rest.split_at(self.depth_count * PIXELS);
            for (color, &background) in color.chunks_exact_mut(PIXELS).zip(&self.constants.background) {
                color.iter_mut().zip(&*left).for_each(|(color, &left)| *color += left * background);
            }
            let part = PartOfImage { tile: &tile, first_row: tile.origin[1], width: grid.width };
            part.write(left, transmittances);
            left.iter_mut().for_each(|left| *left = T::ONE - *left);
            part.write(left, alphas);
            part.write(color, colors);
            part.write(depth, depths);
            part.write(feature, features);
        }
        blended_counts.into_iter().sum()
    }

    /// The planes that the backward pass of a tile starts from: Σ gradient·output, and the gradients of each channel.
    fn gradient_planes(&self, index: usize, outputs: &[&Tensor<T>], output_grads: &[Option<&Tensor<T>>]) -> Vec<T> {
        let (tile, grid) = (self.tile(index), self.lists.on_host().grid);
        let part = PartOfImage { tile: &tile, first_row: 0, width: grid.width };
        let mut planes = vec![T::ZERO; self.planes_len()];
        let mut scratch = planes.clone();
        let (totals, mut rest) = planes.split_at_mut(PIXELS);
        let mut add_products = |gradients: &[T], values: &[T]| {
            for (gradients, values) in gradients.chunks_exact(PIXELS).zip(values.chunks_exact(PIXELS)) {
                let products = gradients.iter().zip(values).map(|(&gradient, &value)| gradient * value);
                totals.iter_mut().zip(products).for_each(|(total, product)| *total += product);
            }
        };
        for (kind, (output, gradient)) in outputs.iter().zip(output_grads).enumerate() {
            if kind == ALPHA {
                let Some(gradient) = gradient else { continue };
                let [gradients, left, ..] = scratch.as_chunks_mut::<PIXELS>().0 else { unreachable!("four planes") };
                part.read(gradient.as_slice(), gradients);
                part.read(&self.transmittance, left);
                gradients.iter_mut().for_each(|gradient| *gradient = -*gradient);
                add_products(gradients, left);
                continue;
            }
            let len = output.len() / (grid.width * grid.height) * PIXELS;
            let gradients;
            (gradients, rest) = rest.split_at_mut(len);
            let Some(gradient) = gradient else { continue };
            let values = &mut scratch[..len];
            part.read(gradient.as_slice(), gradients);
            part.read(output.as_slice(), values);
            add_products(gradients, values);
        }
        planes
    }

    /// [entries, row]: the sums of every (tile, splat).
    fn entry_rows(&self, outputs: &[&Tensor<T>], output_grads: &[Option<&Tensor<T>>]) -> Vec<T> {
        let row_len = ROW_COLORS + 3 + self.extra_count();
        let mut rows = chunked(self.lists.on_host().ranks.len() * row_len, CHUNK, |_, _| ());
        let mut rest = &mut rows[..];
        let mut rows_of_tiles = Vec::with_capacity(self.lists.on_host().grid.tiles());
        for tile in 0..self.lists.on_host().grid.tiles() {
            let (rows_of_tile, after) = rest.split_at_mut(self.lists.on_host().tile(tile).len() * row_len);
            rows_of_tiles.push(rows_of_tile);
            rest = after;
        }
        let body = self.body();
        rows_of_tiles.into_par_iter().enumerate().filter(|(_, rows)| !rows.is_empty()).for_each(|(index, rows)| {
            let mut planes = self.gradient_planes(index, outputs, output_grads);
            body.backward(&self.tile(index), &mut planes, rows);
        });
        rows
    }

    /// [N, row]: the sums of every splat, over its tiles in a fixed order.
    fn splat_rows(&self, entry_rows: &[T]) -> Vec<T> {
        let row_len = ROW_COLORS + 3 + self.extra_count();
        let splats = self.lists.on_host().rank_of_splat.len();
        chunked(splats * row_len, SPLATS_PER_CHUNK * row_len, |first, totals| {
            for (splat, total) in (first / row_len..).zip(totals.chunks_exact_mut(row_len)) {
                for &entry in self.lists.on_host().entries_of_splat(splat) {
                    let row = &entry_rows[entry as usize * row_len..][..row_len];
                    total.iter_mut().zip(row).for_each(|(total, &value)| *total += value);
                }
            }
        })
    }
}

impl<T: Real> Op<T> for Blend<T> {
    fn name(&self) -> &'static str {
        "blending"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        self.splats = RankedSplats::new(inputs, &self.lists.on_host().order);
        let grid = self.lists.on_host().grid;
        let channels = [1, 3, 1, self.depth_count, self.feature_count];
        let body = self.body();
        let blend = |row: usize, images: [&mut [T]; IMAGES]| self.blend_row(&body, row * grid.columns(), images);
        let lens = channels.map(|channels| channels * grid.width * grid.height);
        let (images, counts) = chunked_arrays(lens, channels.map(|channels| channels * grid.width * TILE), blend);
        self.blended_count.store(counts.into_iter().sum(), Ordering::Relaxed);
        let [transmittance, color, alpha, depth, features] = images;
        self.transmittance = transmittance;

        let size = [grid.height, grid.width];
        let mut images = vec![Tensor::from_vec([size[0], size[1], 3], color), Tensor::from_vec(size, alpha)];
        if self.depth_count > 0 {
            images.push(Tensor::from_vec(size, depth));
        }
        if self.feature_count > 0 {
            images.push(Tensor::from_vec([size[0], size[1], self.feature_count], features));
        }
        images
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, output_grads, .. } = pass;
        let row_len = ROW_COLORS + 3 + self.extra_count();
        let splat_rows = self.splat_rows(&self.entry_rows(outputs, output_grads));
        let rows = splat_rows.par_chunks_exact(row_len);
        let conics = inputs[1].as_slice().as_chunks::<3>().0;
        let opacities = inputs[2].as_slice();
        let half = T::from_f64(0.5);

        // Through e = dx + k·dy and σ = ½(A·e² + m·dy²).
        let of_mean = |(row, &[a, k, m]): (&[T], &[T; 3])| [a * row[1], a * k * row[1] + m * row[4]];
        let of_conic = |(row, &[a, _, _]): (&[T], &[T; 3])| [half * row[2], a * row[3], half * row[5]];
        // alpha is opacity·e^(−σ), so ∂/∂opacity = −∂/∂σ / opacity; a culled splat has opacity and gradient 0.
        let of_opacity = |(row, &opacity): (&[T], &T)| if opacity > T::ZERO { -row[0] / opacity } else { T::ZERO };
        let of_color = |row: &[T]| [row[ROW_COLORS], row[ROW_COLORS + 1], row[ROW_COLORS + 2]];
        let means: Vec<[T; 2]> = rows.clone().zip(conics).map(of_mean).collect();
        let conics: Vec<[T; 3]> = rows.clone().zip(conics).map(of_conic).collect();
        let opacities: Vec<T> = rows.clone().zip(opacities).map(of_opacity).collect();
        let colors: Vec<[T; 3]> = rows.clone().map(of_color).collect();
        let mut gradients = vec![means.into_flattened(), conics.into_flattened(), opacities, colors.into_flattened()];
        gradients.push(vec![T::ZERO; inputs[4].len()]);
        let mut first = ROW_COLORS + 3;
        for input in &inputs[5..] {
            let count = input.row_len();
            gradients.push(chunked(input.len(), SPLATS_PER_CHUNK * count, |at, gradients| {
                let rows = splat_rows[at / count * row_len..].chunks_exact(row_len);
                gradients
                    .chunks_exact_mut(count)
                    .zip(rows)
                    .for_each(|(to, row)| to.copy_from_slice(&row[first..][..count]));
            }));
            first += count;
        }
        gradients.into_iter().zip(inputs).map(|(data, input)| Some(Tensor::from_vec(input.shape(), data))).collect()
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Blend<T> {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        let lists = self.lists.clone();
        match &*lists {
            Lists::Gpu(lists) => Some(self.blend_on_gpu(gpu, inputs, lists)),
            Lists::Host(_) => None,
        }
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Lists::Gpu(lists) = &*self.lists else { unreachable!("the forward pass ran on the GPU") };
        self.backward_on_gpu(gpu, pass, lists)
    }
}

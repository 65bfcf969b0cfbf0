//! Values of an image between its pixels.

use crate::gpu::Gpu;
use crate::tape::{Backward, GpuOp, Op, Real, Tensor};

/// The interpolation of a lookup.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sampling {
    /// Always bilinear: for smooth images.
    Bilinear,
    /// The nearest pixel where any channel varies within the 2 × 2 window by more than this share of the window's largest
    /// magnitude, or where a value is not finite: for depth and flow, whose mean across an edge belongs to no surface.
    NearestAcrossEdges {
        /// The limit as a share of the largest magnitude of all channels, e.g. 0.1.
        relative: f64,
    },
}

/// Image [H, W, C], pixels [N, 2] → values [N, C].
pub(super) struct Lookup {
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub sampling: Sampling,
}

/// The texels of one lookup.
struct Window<T> {
    /// Pixel indices, first row before second, left before right; texels beyond the border repeat the border.
    texels: [usize; 4],
    weights: [T; 4],
    /// ∂weights / ∂(u_x, u_y); 0 beyond the outermost pixel centres.
    slopes: [[T; 2]; 4],
}

impl Lookup {
    pub(super) fn new(image_shape: &[usize], sampling: Sampling) -> Self {
        let (height, width, channels) = (image_shape[0], image_shape[1], image_shape.get(2).copied().unwrap_or(1));
        assert!(height > 0 && width > 0, "lookup: an image without pixels");
        Self { width, height, channels, sampling }
    }

    /// 1 where a position lies within the image and all contributing texels are finite, otherwise 0.
    pub(crate) fn validity<T: Real>(&self, image: &Tensor<T>, pixels: &Tensor<T>) -> Tensor<T> {
        let valid = |pixel| if self.window(image.as_slice(), pixel).is_some() { T::ONE } else { T::ZERO };
        Tensor::from_vec([pixels.rows()], pixels.as_slice().as_chunks::<2>().0.iter().map(valid).collect())
    }

    /// The texels and weights at a position; `None` if the lookup is invalid.
    fn window<T: Real>(&self, image: &[T], pixel: &[T; 2]) -> Option<Window<T>> {
        let [x, y] = [Axis::new(pixel[0], self.width)?, Axis::new(pixel[1], self.height)?];
        let corners = [(0, 0), (0, 1), (1, 0), (1, 1)];
        let mut window = Window {
            texels: corners.map(|(j, i)| y.texels[j] * self.width + x.texels[i]),
            weights: corners.map(|(j, i)| y.weights[j] * x.weights[i]),
            slopes: corners.map(|(j, i)| [y.weights[j] * x.slopes[i], x.weights[i] * y.slopes[j]]),
        };
        let varies = match self.sampling {
            Sampling::Bilinear => false,
            Sampling::NearestAcrossEdges { relative } => self.varies(image, &window.texels, T::from_f64(relative)),
        };
        if varies {
            let nearest = |axis: &Axis<T>| usize::from(axis.weights[1] > axis.weights[0]);
            let kept = 2 * nearest(&y) + nearest(&x);
            window.weights = [0, 1, 2, 3].map(|corner| if corner == kept { T::ONE } else { T::ZERO });
            window.slopes = [[T::ZERO; 2]; 4];
        }
        let is_used = |corner: &usize| !varies || window.weights[*corner] != T::ZERO;
        let is_finite = |corner: usize| self.texel(image, window.texels[corner]).iter().all(|value| value.is_finite());
        (0..4).filter(is_used).all(is_finite).then_some(window)
    }

    /// Whether any channel varies by more than `relative` of the largest magnitude; non-finite values vary.
    fn varies<T: Real>(&self, image: &[T], texels: &[usize; 4], relative: T) -> bool {
        let (mut spread, mut largest) = (T::ZERO, T::ZERO);
        for channel in 0..self.channels {
            let values = texels.map(|texel| image[texel * self.channels + channel]);
            if !values.iter().all(|value| value.is_finite()) {
                return true;
            }
            let (low, high) = values.iter().fold((values[0], values[0]), |(low, high), &v| (low.min(v), high.max(v)));
            spread = spread.max(high - low);
            largest = largest.max(high.abs()).max(low.abs());
        }
        spread > relative * largest
    }

    fn texel<'a, T: Real>(&self, image: &'a [T], texel: usize) -> &'a [T] {
        &image[texel * self.channels..(texel + 1) * self.channels]
    }
}

/// The two texels along one axis.
struct Axis<T> {
    texels: [usize; 2],
    weights: [T; 2],
    slopes: [T; 2],
}

impl<T: Real> Axis<T> {
    /// `None` outside the image and for NaN.
    fn new(position: T, size: usize) -> Option<Self> {
        let within = position >= T::ZERO && position <= T::from_f64(size as f64);
        if !within {
            return None;
        }
        let from_first = position - T::from_f64(0.5);
        let last = T::from_f64((size - 1) as f64);
        let clamped = from_first.max(T::ZERO).min(last);
        let first = (clamped.to_f64() as usize).min(size.saturating_sub(2));
        let share = clamped - T::from_f64(first as f64);
        let slope = if clamped == from_first { T::ONE } else { T::ZERO };
        Some(Self {
            texels: [first, (first + 1).min(size - 1)],
            weights: [T::ONE - share, share],
            slopes: [-slope, slope],
        })
    }
}

impl<T: Real> Op<T> for Lookup {
    fn name(&self) -> &'static str {
        "lookup"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let [image, pixels] = [inputs[0].as_slice(), inputs[1].as_slice()];
        let pixels = pixels.as_chunks::<2>().0;
        let mut values = vec![T::ZERO; pixels.len() * self.channels];
        for (values, pixel) in values.chunks_exact_mut(self.channels).zip(pixels) {
            let Some(window) = self.window(image, pixel) else { continue };
            for (texel, weight) in window.contributions() {
                let texel = self.texel(image, texel);
                values.iter_mut().zip(texel).for_each(|(value, &texel)| *value += weight * texel);
            }
        }
        vec![Tensor::from_vec([pixels.len(), self.channels], values)]
    }

    /// Gradients of the image are added point by point, in order.
    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, needs, .. } = pass;
        let d_values = pass.dy();
        let [image, pixels] = [inputs[0].as_slice(), inputs[1].as_slice()];
        let mut d_image = needs[0].then(|| vec![T::ZERO; image.len()]);
        let mut d_pixels = vec![T::ZERO; pixels.len()];
        let rows = pixels.as_chunks::<2>().0.iter().zip(d_values.as_slice().chunks_exact(self.channels));
        for ((pixel, d_value), d_pixel) in rows.zip(d_pixels.as_chunks_mut::<2>().0) {
            let Some(window) = self.window(image, pixel) else { continue };
            for (texel, weight) in window.contributions() {
                let Some(d_image) = &mut d_image else { break };
                let d_texel = &mut d_image[texel * self.channels..(texel + 1) * self.channels];
                d_texel.iter_mut().zip(d_value).for_each(|(total, &d_value)| *total += weight * d_value);
            }
            for (texel, slope) in window.texels.into_iter().zip(window.slopes) {
                if slope == [T::ZERO; 2] {
                    continue;
                }
                let along: T = self.texel(image, texel).iter().zip(d_value).map(|(&texel, &d)| texel * d).sum();
                (0..2).for_each(|axis| d_pixel[axis] += slope[axis] * along);
            }
        }
        vec![
            d_image.map(|values| Tensor::from_vec(inputs[0].shape(), values)),
            Some(Tensor::from_vec(inputs[1].shape(), d_pixels)),
        ]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Lookup {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![self.values_on_gpu(gpu, inputs)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, needs, .. } = pass;
        self.backward_on_gpu(gpu, inputs, pass.dy(), needs)
    }
}

impl<T: Real> Window<T> {
    /// Texels with a weight.
    fn contributions(&self) -> impl Iterator<Item = (usize, T)> {
        self.texels.into_iter().zip(self.weights).filter(|(_, weight)| *weight != T::ZERO)
    }
}

//! Structural similarity of two images (Wang et al. 2004) as a differentiable mean over pixels and channels.
//!
//! With a Gaussian window of 11 taps and σ = 1.5, the windowed means μ1, μ2, E`[x²]`, E`[y²]`, E`[xy]` of the images x and y
//! (per pixel and channel) give the variances σ1² = E`[x²]` − μ1², σ2² = E`[y²]` − μ2², the covariance σ12 = E`[xy]` − μ1·μ2 and
//!
//! SSIM = C·D / (A·B),  A = μ1² + μ2² + C1,  B = σ1² + σ2² + C2,  C = 2·μ1·μ2 + C1,  D = 2·σ12 + C2,
//!
//! with C1 = 0.01² and C2 = 0.03² for values in [0, 1]. Where cancellation makes a variance negative, it and the covariance
//! count as 0 with gradient 0; where rounding makes SSIM exceed 1, it counts as 1 with gradient 0.

mod cpu;
mod gpu;
#[cfg(test)]
mod gpu_tests;
mod reference;
#[cfg(test)]
mod tests;

use crate::gpu::{Gpu, GpuArray};
use crate::tape::chunks::{CHUNK, chunked};
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// Taps on each side of the centre of the window.
const RADIUS: usize = 5;
const TAPS: usize = 2 * RADIUS + 1;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Which windows count.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub enum Window {
    /// One window per pixel; outside the image both images are 0 (3DGS).
    ZeroPadded,
    /// Only windows that lie within the image, which must have at least 11×11 pixels.
    Valid,
}

/// Mean SSIM, shape `[1]`, of `render` and `target` [H, W, channels] with values in [0, 1].
///
/// Gradients flow to `render` only; `target` must be a constant.
pub fn ssim<T: Real>(tape: &mut Tape<T>, render: Var, target: Var, window: Window) -> Var {
    let shape = tape.value(render).shape();
    assert_eq!(shape, tape.value(target).shape(), "ssim: images differ in shape");
    assert_eq!(shape.len(), 3, "ssim: images must be [H, W, channels]");
    assert!(!tape.needs_gradient(target), "ssim: the target must be a constant");
    let layout = Layout { height: shape[0], width: shape[1], channels: shape[2], window };
    assert!(layout.windows() > 0, "ssim: no window fits into an image of shape {shape:?}");
    let keep_gradients = tape.needs_gradient(render);
    tape.apply_one(Ssim { layout, keep_gradients, gradient: Vec::new(), on_gpu: None }, &[render, target])
}

/// Image size and the windows that count.
#[derive(Copy, Clone)]
struct Layout {
    height: usize,
    width: usize,
    channels: usize,
    window: Window,
}

impl Layout {
    fn row_len(&self) -> usize {
        self.width * self.channels
    }

    /// Pixels at each end of a row or column whose window is excluded.
    fn margin(&self) -> usize {
        if self.window == Window::Valid { RADIUS } else { 0 }
    }

    /// Windows of all channels.
    fn windows(&self) -> usize {
        let along = |pixels: usize| pixels.saturating_sub(2 * self.margin());
        along(self.height) * along(self.width) * self.channels
    }

    fn counts_row(&self, y: usize) -> bool {
        (self.margin()..self.height.saturating_sub(self.margin())).contains(&y)
    }

    /// Elements of a row whose windows are included.
    fn counted_columns(&self) -> std::ops::Range<usize> {
        self.margin() * self.channels..(self.width - self.margin()) * self.channels
    }
}

/// The weights of the window along one axis; they sum to 1.
fn weights<T: Real>() -> [T; TAPS] {
    let unnormalised: [f64; TAPS] =
        std::array::from_fn(|tap| (-0.5 * ((tap as f64 - RADIUS as f64) / SIGMA).powi(2)).exp());
    let sum: f64 = unnormalised.iter().sum();
    unnormalised.map(|weight| T::from_f64(weight / sum))
}

/// Windowed means of x, y, x², y² and xy.
#[derive(Copy, Clone)]
struct Moments<T> {
    x: T,
    y: T,
    xx: T,
    yy: T,
    xy: T,
}

/// SSIM of one window and its derivatives with respect to the means of x, x² and xy.
#[derive(Copy, Clone)]
struct Similarity<T> {
    value: T,
    d_x: T,
    d_xx: T,
    d_xy: T,
}

#[inline(always)]
fn similarity<T: Real>(m: Moments<T>) -> Similarity<T> {
    let (zero, one, two) = (T::ZERO, T::ONE, T::from_f64(2.0));
    let (c1, c2) = (T::from_f64(C1), T::from_f64(C2));
    let (variance_x, variance_y) = (m.xx - m.x * m.x, m.yy - m.y * m.y);
    let clamped = variance_x < zero || variance_y < zero;
    let keep = |value: T, clamped: bool| if clamped { zero } else { value };
    let covariance = keep(m.xy - m.x * m.y, clamped);

    let a = m.x * m.x + m.y * m.y + c1;
    let b = keep(variance_x, variance_x < zero) + keep(variance_y, variance_y < zero) + c2;
    let c = two * m.x * m.y + c1;
    let d = two * covariance + c2;
    let inverse = one / (a * b);
    let value = c * d * inverse;

    let (per_a, per_b) = (b * inverse, a * inverse);
    let above_one = value > one;
    let d_xx = keep(-value * per_b, variance_x < zero || above_one);
    let d_xy = keep(two * c * inverse, clamped || above_one);
    // The mean of x enters A and C directly, B and D through the variance and the covariance.
    let direct = keep(two * (m.y * d * inverse - m.x * value * per_a), above_one);
    let d_x = direct - two * m.x * d_xx - m.y * d_xy;
    Similarity { value: if above_one { one } else { value }, d_x, d_xx, d_xy }
}

struct Ssim<T> {
    layout: Layout,
    keep_gradients: bool,
    /// On the CPU: the derivative of Σ SSIM with respect to every element of `render`.
    gradient: Vec<T>,
    /// On a GPU: the derivatives of every window's SSIM, d_x of every channel in planes, then d_xx and d_xy.
    on_gpu: Option<GpuArray>,
}

impl<T: Real> Op<T> for Ssim<T> {
    fn name(&self) -> &'static str {
        "ssim"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let (x, y) = (inputs[0].as_slice(), inputs[1].as_slice());
        let (sum, gradient) = match (T::as_f32(x), T::as_f32(y)) {
            (Some(x), Some(y)) => cpu::sum_and_gradient(&self.layout, x, y),
            _ => reference::sum_and_gradient(&self.layout, x, y),
        };
        if self.keep_gradients {
            self.gradient = gradient;
        }
        vec![Tensor::scalar(T::from_f64(sum / self.layout.windows() as f64))]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let per_window = pass.dy().as_slice()[0] / T::from_f64(self.layout.windows() as f64);
        let dx = chunked(self.gradient.len(), CHUNK, |start, dx| {
            let gradient = &self.gradient[start..];
            dx.iter_mut().zip(gradient).for_each(|(dx, &gradient)| *dx = gradient * per_window);
        });
        vec![Some(Tensor::from_vec(pass.inputs[0].shape(), dx)), None]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Ssim<T> {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![self.forward_on_gpu(gpu, inputs)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![Some(self.backward_on_gpu(gpu, pass.inputs, pass.dy())), None]
    }
}

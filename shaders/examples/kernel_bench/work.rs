//! The minimum work of kernels.

use shaders::gpu::Rates;
use shaders::rasteriser::{self, RasterSettings};
use shaders::tape::{Device, Tape};

use crate::scenes::{WIDTH, ball, camera, field};

/// Measured runs, after those that compile and warm up.
pub(crate) const RUNS: usize = 20;
/// A layer, forward and backward: on a GPU, both use the same kernels.
pub(crate) const LAYER: &str = "linear";
/// SSIM, forward and backward: on the CPU, the forward pass already computes the gradient.
pub(crate) const SSIM: &str = "ssim";
/// Bytes of a number.
const WORD: f64 = 4.0;

/// The minimum work of a task in a run.
pub(crate) struct Work {
    /// The name of the task. That of a backward pass ends with `backward`; [`LAYER`] and [`SSIM`] cover both passes.
    pub(crate) task: &'static str,
    /// Bytes read and written.
    bytes: f64,
    flops: f64,
}

/// A task with its measured time.
pub(crate) struct Row {
    work: Work,
    rates: Rates,
    ms: f64,
    /// Launches of kernels in a run; `None` on the CPU.
    launches: Option<u64>,
}

impl Work {
    /// Its row, given the seconds and the launches of a run.
    pub(crate) fn took(self, secs: f64, launches: Option<u64>, rates: Rates) -> Row {
        Row { work: self, rates, ms: 1e3 * secs, launches }
    }
}

impl Row {
    pub(crate) fn json(&self) -> String {
        let Row { work: Work { task, bytes, flops }, rates, ms, launches } = self;
        let floor_ms = 1e3 * rates.floor_secs(*bytes, *flops);
        let launches = launches.map_or(String::new(), |launches| format!("\"launches\": {launches}, "));
        format!(
            "    {{ \"kernel\": {task:?}, {launches}\"ms\": {ms:.5}, \"bytes\": {bytes:.0}, \"flops\": {flops:.0}, \
             \"floor_ms\": {floor_ms:.5} }}"
        )
    }
}

/// A rendered and differentiated ball.
pub(crate) fn render(splats: usize, size: usize) -> Vec<Work> {
    let stats = {
        let mut tape = Tape::new(Device::Cpu);
        let vars = ball(splats).constants(&mut tape);
        let rendered = rasteriser::render(&mut tape, &vars, None, &camera(size), &RasterSettings::default());
        rendered.expect("it fits").stats()
    };
    let entries = stats.intersections as f64;
    let (count, pixels) = (splats as f64, (size * size) as f64);
    // Per splat: position, scales, rotation, opacity, 48 harmonics; and means, conic, depth, opacity, colour, cutoff.
    let (parameters, projected) = (59.0 * WORD, 11.0 * WORD);
    // Per pair of a pixel and a splat that it blends: offset, exponent, alpha, three colours; backward about
    // three times that. The backward pass reads an image and its gradient, and has no gradients of depths and cutoffs.
    let pairs = stats.blended_pixel_splats.expect("counted on the CPU") as f64;
    let (seen, image) = (count * projected + entries * WORD, pixels * 4.0 * WORD);
    let seen_backward = seen + 2.0 * image + count * 9.0 * WORD;
    let work = |task, bytes, flops| Work { task, bytes, flops };
    vec![
        work("projection", count * (parameters + projected), count * 500.0),
        work("projection backward", count * (2.0 * parameters + projected), count * 1500.0),
        work("binning", count * projected + 4.0 * entries * WORD, 0.0),
        work("blending", seen + image, pairs * 20.0),
        work("blending backward", seen_backward, pairs * 60.0),
    ]
}

/// A layer and a field at N points, forward and backward.
pub(crate) fn dense(points: usize) -> Vec<Work> {
    let (count, width) = (points as f64, WIDTH as f64);
    let texels: f64 = field().plane_shapes().iter().map(|plane| plane.iter().product::<usize>() as f64).sum();
    let features = field().features() as f64;
    let work = |task, numbers: f64, flops| Work { task, bytes: numbers * WORD, flops };
    vec![
        // The value, and the gradients of inputs and of weights.
        work(LAYER, 5.0 * count * width, 3.0 * 2.0 * count * width * width),
        work("hexplane", texels + count * (3.0 + features), count * features * 60.0),
        work("hexplane backward", 2.0 * texels + count * (6.0 + features), count * features * 150.0),
    ]
}

/// The photometric loss of an image.
pub(crate) fn losses(size: usize) -> Vec<Work> {
    let numbers = (3 * size * size) as f64;
    let work = |task, touched: f64, flops: f64| Work { task, bytes: touched * numbers * WORD, flops: flops * numbers };
    vec![
        // Five moments and three derivatives by two passes of eleven taps; reads both images in each pass.
        work(SSIM, 5.0, (5.0 + 3.0) * 2.0 * 2.0 * 11.0 + 50.0),
        work("l1", 2.0, 3.0),
        work("l1 backward", 3.0, 2.0),
    ]
}

/// A step of the optimiser on the harmonics of all splats.
pub(crate) fn optimizer(splats: usize) -> Vec<Work> {
    let numbers = (48 * splats) as f64;
    vec![Work { task: "adam", bytes: 7.0 * numbers * WORD, flops: numbers * 12.0 }]
}

use super::*;
use crate::check::{self, TOLERANCE, noise};
use crate::rasteriser::binning::{self, Grid};
use crate::tape::Device;

/// Projected splats given directly.
#[derive(Clone)]
pub(super) struct Scene {
    pub means2d: Vec<[f64; 2]>,
    pub conics: Vec<[f64; 3]>,
    pub opacities: Vec<f64>,
    pub colors: Vec<[f64; 3]>,
}

impl Scene {
    /// `count` splats of the same opacity, round and with a standard deviation of `sigma_px`, on top of each other.
    fn stack(count: usize, center: [f64; 2], sigma_px: f64, opacity: f64) -> Self {
        let precision = sigma_px.powi(-2);
        Self {
            means2d: vec![center; count],
            conics: vec![[precision, 0.0, precision]; count],
            opacities: vec![opacity; count],
            colors: noise(3 * count, 9).as_chunks().0.to_vec(),
        }
    }

    pub(super) fn tensors<T: Real>(&self) -> [Tensor<T>; 4] {
        let count = self.opacities.len();
        let tensor = |row_len, data: &[f64]| {
            let shape = if row_len == 1 { vec![count] } else { vec![count, row_len] };
            Tensor::from_vec(shape, data.iter().map(|&value| T::from_f64(value)).collect())
        };
        [
            tensor(2, self.means2d.as_flattened()),
            tensor(3, self.conics.as_flattened()),
            tensor(1, &self.opacities),
            tensor(3, self.colors.as_flattened()),
        ]
    }
}

/// Blends variables (mean, conic, opacity, colour); depths rise with the index.
pub(super) fn blend_vars<T: Real>(
    tape: &mut Tape<T>,
    vars: &[Var],
    features: Option<Var>,
    size: [usize; 2],
    settings: &RasterSettings,
) -> Blended {
    let &[means2d, conics, opacities, colors] = vars else { panic!("four variables") };
    let alpha_min = T::from_f64(settings.alpha_min());
    let cutoffs: Vec<T> = tape.value(opacities).as_slice().iter().map(|&o| (o / alpha_min).ln()).collect();
    let count = cutoffs.len();
    let depths = tape.constant(Tensor::from_vec([count], (0..count).map(|i| T::from_f64(1.0 + i as f64)).collect()));
    let cutoffs = tape.constant(Tensor::from_vec([count], cutoffs));
    let projected = ProjectedVars { means2d, conics, depths, opacities, colors, cutoffs };
    let lists = binning::bin(tape, &projected, Grid { width: size[0], height: size[1] }).unwrap();
    blend(tape, &projected, features, &lists, settings)
}

/// Colour, alpha and gradients by mean, conic, opacity and colour for a gradient of one everywhere in the colour.
fn run<T: Real>(scene: &Scene, size: [usize; 2], settings: &RasterSettings) -> (Vec<Tensor<T>>, u64) {
    let mut tape = Tape::new(Device::Cpu);
    let vars = scene.tensors::<T>().map(|tensor| tape.leaf(tensor));
    let blended = blend_vars(&mut tape, &vars, None, size, settings);
    let seed = Tensor::full(tape.value(blended.color).shape(), T::ONE);
    let mut gradients = tape.backward(&[(blended.color, seed)]);
    let images = [blended.color, blended.alpha].map(|var| tape.value(var).clone());
    let gradients = vars.map(|var| gradients.take(var).expect("a gradient"));
    (images.into_iter().chain(gradients).collect(), blended.blended_count.expect("counted on the CPU"))
}

#[test]
fn gradients_are_central_differences() {
    let scene = Scene {
        means2d: vec![[5.3, 4.2], [9.1, 8.7], [17.2, 3.9]],
        conics: vec![[0.1, 0.7, 0.05], [0.3, -1.2, 0.2], [0.02, 0.1, 0.4]],
        opacities: vec![0.5, 0.8, 0.3],
        colors: noise(9, 1).as_chunks().0.to_vec(),
    };
    let settings = RasterSettings { smooth_cutoff: true, background: [0.2, 0.9, 0.4], ..RasterSettings::default() };
    let outputs: [fn(&Blended) -> Var; 2] = [|blended| blended.color, |blended| blended.alpha];
    for output in outputs {
        let f = |tape: &mut Tape<f64>, vars: &[Var]| output(&blend_vars(tape, vars, None, [20, 12], &settings));
        check::gradients(f, &scene.tensors(), TOLERANCE).unwrap();
    }
    let with_features = |tape: &mut Tape<f64>, vars: &[Var]| {
        let settings = RasterSettings { depth: true, ..settings };
        blend_vars(tape, &vars[..4], Some(vars[4]), [20, 12], &settings).features.unwrap()
    };
    let mut inputs = scene.tensors().to_vec();
    inputs.push(Tensor::from_vec([3, 2], noise(6, 2)));
    check::gradients(with_features, &inputs, TOLERANCE).unwrap();
}

#[test]
fn a_saturated_splat_is_capped_and_only_its_colour_learns() {
    let settings = RasterSettings { background: [0.0, 0.0, 1.0], ..RasterSettings::default() };
    let scene = Scene { colors: vec![[1.0, 0.5, 0.0]], ..Scene::stack(1, [0.5, 0.5], 3.0, 1.0) };
    let (tensors, count) = run::<f32>(&scene, [1, 1], &settings);
    let [color, alpha, means, conics, opacities, colors] = &tensors[..] else { unreachable!("six tensors") };
    check::agree(color, &Tensor::from_vec([1, 1, 3], vec![0.99, 0.495, 0.01]), 1e-6).unwrap();
    check::agree(alpha, &Tensor::from_vec([1, 1], vec![0.99]), 1e-6).unwrap();
    check::agree(colors, &Tensor::from_vec([1, 3], vec![0.99; 3]), 1e-6).unwrap();
    assert!([means, conics, opacities].iter().all(|gradient| gradient.as_slice().iter().all(|&value| value == 0.0)));
    assert_eq!(count, 1);
}

#[test]
fn a_splat_that_would_stop_a_pixel_is_not_blended() {
    // Alphas of 0.99 leave 1e-2, then 1e-4 up to rounding: place the stop on either side of it.
    let scene = Scene::stack(3, [0.5, 0.5], 3.0, 1.0);
    for (stop, expected) in [(1.1e-4, 1), (0.9e-4, 2)] {
        let settings = RasterSettings { transmittance_stop: stop, ..RasterSettings::default() };
        let (fast, fast_count) = run::<f32>(&scene, [1, 1], &settings);
        let (reference, count) = run::<f64>(&scene, [1, 1], &settings);
        assert_eq!((fast_count, count), (expected, expected));
        for (fast, reference) in fast.iter().zip(&reference) {
            check::agree(fast, reference, 1e-5).unwrap();
        }
        let colors = reference[5].as_slice();
        assert!(colors[3 * expected as usize..].iter().all(|&gradient| gradient == 0.0), "those behind get nothing");
    }
}

#[test]
fn weights_and_transmittance_add_up_to_one() {
    let scene = Scene::stack(50, [9.3, 7.8], 5.0, 0.9);
    for depth in [false, true] {
        let mut tape = Tape::<f32>::new(Device::Cpu);
        let vars = scene.tensors().map(|tensor| tape.leaf(tensor));
        let ones = tape.leaf(Tensor::full([50, 1], 1.0));
        let settings = RasterSettings { depth, ..RasterSettings::default() };
        let blended = blend_vars(&mut tape, &vars, Some(ones), [20, 16], &settings);
        let weights = tape.value(blended.features.unwrap()).as_slice().iter();
        for (weight, alpha) in weights.zip(tape.value(blended.alpha).as_slice()) {
            assert!((weight - alpha).abs() <= 2e-6 && *weight >= 0.0, "{weight} {alpha}");
        }
    }
    let settings = RasterSettings::default();
    assert_eq!(run::<f32>(&scene, [20, 16], &settings).1, run::<f64>(&scene, [20, 16], &settings).1);
}

#[test]
fn many_layers_keep_their_gradient() {
    // 400 faint layers: the remaining sum is the result of 400 subtractions.
    let scene = Scene::stack(400, [8.3, 7.6], 4.0, 0.02);
    let (fast, _) = run::<f32>(&scene, [16, 16], &RasterSettings::default());
    let (reference, _) = run::<f64>(&scene, [16, 16], &RasterSettings::default());
    for (fast, reference) in fast.iter().zip(&reference) {
        check::agree(fast, reference, 1e-3).unwrap();
    }
}

#[test]
fn a_needle_has_no_holes() {
    // 45°, axis ratio 1e4 before dilation: variances 2·1e8·½ and covariance almost as large.
    let (long, dilation) = (1e8, 0.3);
    let (variance, covariance) = (0.5 * long + dilation, 0.5 * long);
    let conditional = dilation + dilation * covariance / variance;
    let scene = Scene {
        means2d: vec![[32.0, 32.0]],
        conics: vec![[1.0 / conditional, -covariance / variance, 1.0 / variance]],
        opacities: vec![0.5],
        colors: vec![[1.0; 3]],
    };
    let (images, _) = run::<f32>(&scene, [64, 64], &RasterSettings::default());
    for step in 0..64 {
        let alpha = images[1].as_slice()[step * 64 + step];
        assert!((alpha - 0.5).abs() <= 1e-3, "pixel {step}: {alpha}");
    }
}

#[test]
fn depth_of_a_single_splat_is_its_own() {
    let scene = Scene::stack(1, [4.0, 4.0], 2.0, 0.7);
    let mut tape = Tape::<f32>::new(Device::Cpu);
    let vars = scene.tensors().map(|tensor| tape.leaf(tensor));
    let settings = RasterSettings { depth: true, ..RasterSettings::default() };
    let blended = blend_vars(&mut tape, &vars, None, [20, 8], &settings);
    let (depth, alpha) = (tape.value(blended.depth.unwrap()), tape.value(blended.alpha));
    for (&depth, &alpha) in depth.as_slice().iter().zip(alpha.as_slice()) {
        let is_right = if alpha > 0.0 { (depth / alpha - 1.0).abs() <= 1e-6 } else { depth == 0.0 };
        // 1 − (1 − alpha) loses a digit where alpha is small.
        assert!(is_right || (depth - alpha).abs() <= 1e-7, "{depth} {alpha}");
    }
}

#[test]
fn a_faint_pixel_is_skipped_forward_and_backward() {
    // At a distance where alpha is just below 1/255, the pixel receives no colour and passes no gradient; just above,
    // it does both.
    for (alpha, is_blended) in [(0.999 / 255.0, false), (1.001 / 255.0, true)] {
        let distance = (-2.0 * (alpha / 0.5_f64).ln()).sqrt() * 2.0;
        let scene = Scene::stack(1, [0.5 - distance, 0.5], 2.0, 0.5);
        let (tensors, count) = run::<f32>(&scene, [1, 1], &RasterSettings::default());
        assert_eq!(count, u64::from(is_blended));
        assert!(tensors.iter().all(|tensor| tensor.as_slice().iter().any(|&value| value != 0.0) == is_blended));
    }
}

#[test]
fn powers_of_two_are_accurate() {
    let worst = (0..=100_000).map(|step| {
        let x = -9.0 * step as f32 / 100_000.0;
        (f64::from(kernel::exp2_of(x)) / f64::from(x).exp2() - 1.0).abs()
    });
    let worst = worst.fold(0.0, f64::max);
    assert!(worst <= 3e-7, "{worst:e}");
}

#[test]
fn a_row_of_wrong_values_is_noticed() {
    // Planted fault: the comparison of fast and reference gradients rejects a splat that is off by a per mille.
    let scene = Scene::stack(20, [8.0, 8.0], 3.0, 0.2);
    let moved = Scene { means2d: vec![[8.004, 8.0]; 20], ..scene.clone() };
    let (fast, _) = run::<f32>(&moved, [16, 16], &RasterSettings::default());
    let (reference, _) = run::<f64>(&scene, [16, 16], &RasterSettings::default());
    assert!(fast.iter().zip(&reference).any(|(fast, reference)| check::agree(fast, reference, 1e-3).is_err()));
}

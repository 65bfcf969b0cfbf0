//! Renders of arbitrary scenes: parameters take any value, cameras and images extreme sizes.

use super::scene_tests::{camera, cast, from_tensors, splats, tensors};
use super::*;
use crate::check::noise;
use crate::rasteriser::NOT_FINITE;

/// Values that break careless arithmetic.
const POISONS: [f32; 12] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    f32::MIN_POSITIVE,
    1e-42,
    0.0,
    -0.0,
    1e19,
    -1e19,
    88.8,
];
const SIZES: [(usize, usize); 8] = [(1, 1), (1, 300), (300, 1), (16, 16), (17, 15), (3, 64), (65, 33), (31, 2)];
const ROUNDS: u64 = 400;
/// The field of the harmonics, and the largest coefficient that takes part.
const SH: usize = 4;
const BRIGHTEST: f32 = 1e9;

struct Case {
    scene: SplatTensors<f32>,
    camera: PinholeCamera,
    settings: RasterSettings,
}

fn case(seed: u64) -> Case {
    let mut numbers = noise(100, 10_000 + seed).into_iter();
    let mut share = || 0.5 + 0.5 * numbers.next().expect("enough numbers");
    let mut below = |count: usize| ((share() * count as f64) as usize).min(count - 1);
    let mut scene = tensors(&cast::<f32>(&splats(24, -1.5, seed)));
    for _ in 0..below(20) {
        let field = below(5);
        let (at, poison) = (below(scene[field].len()), POISONS[below(POISONS.len())]);
        // Colours of 1e19 are rendered, but their gradients are products of two such numbers: an overflow that
        // a training reports by name.
        let is_too_bright = field == SH && poison.is_finite() && poison.abs() > BRIGHTEST;
        scene[field].make_mut()[at] = if is_too_bright { BRIGHTEST } else { poison };
    }
    let (width, height) = SIZES[below(SIZES.len())];
    let mut camera = camera(width, height);
    // From a fisheye to a telephoto lens, and into the midst of the splats.
    let zoom = [1e-3, 0.03, 1.0, 30.0, 1e4][below(5)];
    camera.focal = camera.focal.map(|focal| zoom * focal);
    camera.translation[2] = [4.0, 0.0, 1e-3, 1e6][below(4)];
    let near_view = [0.01, 0.2, 1e-6][below(3)];
    let settings = RasterSettings { near_view, depth: below(2) == 0, ..RasterSettings::default() };
    Case { scene: from_tensors(&scene), camera, settings }
}

/// The first of colour, alpha, depth and gradients with a value that is not finite, or out of the range of its kind.
fn fault(case: &Case) -> Option<String> {
    let mut tape = Tape::new(Device::Cpu);
    let vars = case.scene.leaves(&mut tape);
    let Ok(rendered) = render(&mut tape, &vars, None, &case.camera, &case.settings) else { return None };
    let alpha = tape.value(rendered.alpha);
    if !alpha.as_slice().iter().all(|alpha| (0.0..=1.0).contains(alpha)) {
        return Some("an alpha outside of [0, 1]".into());
    }
    let images = [Some(rendered.color), Some(rendered.alpha), rendered.depth];
    let mut seeds = Vec::new();
    for (index, image) in images.into_iter().flatten().enumerate() {
        let value = tape.value(image);
        if !value.is_finite() {
            return Some(format!("image {index} is not finite"));
        }
        let weights = noise(value.len(), index as u64).into_iter().map(|weight| weight as f32).collect();
        seeds.push((image, Tensor::from_vec(value.shape(), weights)));
    }
    let gradients = tape.backward(&seeds);
    let (log_scales, rotations) = vars.shape.scales_and_rotations()?;
    let fields = [vars.positions, log_scales, rotations, vars.opacity_logits, vars.sh];
    let bad = fields.iter().position(|field| gradients.get(*field).is_some_and(|gradient| !gradient.is_finite()));
    bad.map(|field| format!("the gradient of field {field} is not finite"))
}

#[test]
fn extreme_scenes_give_finite_images_and_gradients() {
    let faults: Vec<String> =
        (0..ROUNDS).filter_map(|seed| Some(format!("seed {seed}: {}", fault(&case(seed))?))).collect();
    assert!(faults.is_empty(), "{} of {ROUNDS}:\n{}", faults.len(), faults.join("\n"));
}

#[test]
fn splats_that_are_not_finite_are_counted() {
    for field in 0..5 {
        let mut scene = tensors(&cast::<f32>(&splats(24, -1.5, 3)));
        scene[field].make_mut()[0] = f32::NAN;
        let mut tape = Tape::new(Device::Cpu);
        let vars = from_tensors(&scene).constants(&mut tape);
        render(&mut tape, &vars, None, &camera(40, 40), &RasterSettings::default()).unwrap();
        assert_eq!(tape.profile().events.get(NOT_FINITE), Some(&1), "field {field}");
    }
    let mut whole = tensors(&cast::<f32>(&splats(24, -1.5, 3)));
    whole[0].make_mut()[2] = -50.0;
    whole[1].make_mut()[3] = 99.0;
    whole[3].make_mut()[2] = 30.0;
    whole[4].make_mut()[3 * 48] = -9.0;
    let mut tape = Tape::new(Device::Cpu);
    let vars = from_tensors(&whole).constants(&mut tape);
    render(&mut tape, &vars, None, &camera(40, 40), &RasterSettings::default()).unwrap();
    let events = &tape.profile().events;
    assert_eq!(events.get(NOT_FINITE), None, "{events:?}");
    for guard in [
        "splats in front of the near plane",
        "splats with extreme values",
        "opacities above the cap",
        "color channels below zero",
    ] {
        assert!(events.get(guard).is_some_and(|count| *count >= 1), "{guard}: {events:?}");
    }
}

use super::scene_tests::{camera, cast, from_tensors, images, select, splats, tensors, vars, with_threads};
use super::*;
use crate::check::{self, TOLERANCE, noise};
use crate::rasteriser::isa::Isa;

/// Threshold crossings that differ between f32 and f64 or between two bodies change a pixel by up to one 8-bit level each.
const MAX_FLIP: f64 = 2.0 / 255.0;

/// Settings for finite differences: no jumps at the threshold or the stop.
fn smooth() -> RasterSettings {
    RasterSettings {
        smooth_cutoff: true,
        transmittance_stop: 0.0,
        background: [0.3, 0.1, 0.6],
        depth: true,
        ..RasterSettings::default()
    }
}

/// All outputs of a render, with one seed gradient per image: images, then gradients of parameters, means, features.
fn render_and_gradients<T: Real>(
    splats: &SplatTensors<T>,
    features: Option<&Tensor<T>>,
    camera: &PinholeCamera,
    settings: &RasterSettings,
) -> (Vec<Tensor<T>>, Vec<Tensor<T>>) {
    let mut tape = Tape::new(Device::Cpu);
    let leaves = splats.leaves(&mut tape);
    let features = features.map(|features| tape.leaf(features.clone()));
    let rendered = render(&mut tape, &leaves, features, camera, settings).unwrap();
    let outputs = images(&rendered);
    let images: Vec<Tensor<T>> = outputs.iter().map(|&output| tape.value(output).clone()).collect();
    let seed = |(index, image): (usize, &Tensor<T>)| {
        let weights = noise(image.len(), 77 + index as u64).into_iter().map(T::from_f64).collect();
        Tensor::from_vec(image.shape(), weights)
    };
    let seeds: Vec<_> = outputs.iter().copied().zip(images.iter().enumerate().map(seed)).collect();
    let mut gradients = tape.backward(&seeds);
    let SplatVars { positions, shape, opacity_logits, sh } = leaves;
    let (log_scales, rotations) = shape.scales_and_rotations().unwrap();
    let inputs = [positions, log_scales, rotations, opacity_logits, sh, rendered.means2d];
    let inputs = inputs.into_iter().chain(features);
    (images, inputs.map(|input| gradients.take(input).expect("every parameter has a gradient")).collect())
}

/// Gradient of the colour by all parameters, without depth and features.
fn color_run(splats: &SplatTensors<f32>, camera: &PinholeCamera, isa: Isa) -> (Vec<Tensor<f32>>, Vec<Tensor<f32>>) {
    render_and_gradients(splats, None, camera, &RasterSettings { isa, ..RasterSettings::default() })
}

#[test]
fn whole_render_gradients_are_central_differences() {
    let camera = camera(20, 18);
    let features = Tensor::from_vec([6, 2], noise(12, 5));
    for degree in 0..=3 {
        let settings = RasterSettings { sh_degree: degree, ..smooth() };
        let mut inputs = tensors(&splats(6, -1.5, degree as u64));
        inputs.push(features.clone());
        let output = |which: fn(&Rendered) -> Var| {
            let f = |tape: &mut Tape<f64>, inputs: &[Var]| {
                which(&render(tape, &vars(&inputs[..5]), Some(inputs[5]), &camera, &settings).unwrap())
            };
            check::gradients(f, &inputs, TOLERANCE)
        };
        output(|rendered| rendered.color).unwrap();
        if degree > 0 {
            continue;
        }
        output(|rendered| rendered.alpha).unwrap();
        output(|rendered| rendered.depth.unwrap()).unwrap();
        output(|rendered| rendered.features.unwrap()).unwrap();
    }
}

#[test]
fn the_gradient_check_sees_every_parameter() {
    // Planted fault: the gradient of one parameter at a time is cut off.
    let camera = camera(12, 10);
    let inputs = tensors(&splats(3, -1.5, 1));
    for field in 0..5 {
        let f = |tape: &mut Tape<f64>, inputs: &[Var]| {
            let mut inputs = inputs.to_vec();
            inputs[field] = tape.detach(inputs[field]);
            render(tape, &vars(&inputs), None, &camera, &smooth()).unwrap().color
        };
        let mismatch = check::gradients(f, &inputs, TOLERANCE).unwrap_err();
        assert_eq!(mismatch.what, format!("input {field}"));
    }
}

#[test]
fn fast_f32_agrees_with_the_f64_reference() {
    let features = Tensor::from_vec([400, 3], noise(1200, 9));
    for (width, height) in [(64, 48), (33, 47), (97, 17)] {
        let camera = camera(width, height);
        let settings = RasterSettings { depth: true, background: [1.0, 0.5, 0.0], ..RasterSettings::default() };
        let scene = splats(400, -2.5, 3);
        let (expected, expected_gradients) = render_and_gradients(&scene, Some(&features), &camera, &settings);
        let (found, gradients) = render_and_gradients::<f32>(&cast(&scene), Some(&features.cast()), &camera, &settings);
        for (found, expected) in found.iter().zip(&expected) {
            // Depths reach 6 scene units, everything else is of order one.
            check::agree(found, expected, 6.0 * MAX_FLIP).unwrap();
            let differences: Vec<f64> =
                found.as_slice().iter().zip(expected.as_slice()).map(|(a, b)| (f64::from(*a) - b).abs()).collect();
            let mean = differences.iter().sum::<f64>() / differences.len() as f64;
            assert!(mean <= 3e-6, "mean difference {mean:e}");
            let outliers = differences.iter().filter(|&&difference| !(difference <= 2e-5)).count();
            assert!(outliers * 500 <= differences.len(), "{outliers} of {} differ", differences.len());
        }
        for (found, expected) in gradients.iter().zip(&expected_gradients) {
            check::agree(found, expected, 2e-3).unwrap();
        }
    }
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let camera = camera(53, 37);
    let scene: SplatTensors<f32> = cast(&splats(600, -2.2, 4));
    let features = Tensor::from_vec([600, 2], noise(1200, 1)).cast();
    let run = |isa, depth| {
        let settings = RasterSettings { isa, depth, ..RasterSettings::default() };
        render_and_gradients(&scene, depth.then_some(&features), &camera, &settings)
    };
    for isa in Isa::available() {
        for depth in [false, true] {
            assert!(run(isa, depth) == run(Isa::Portable, depth), "{isa:?} differs from the portable body");
        }
    }
    let other = render_and_gradients(&cast(&splats(600, -2.2, 5)), None, &camera, &RasterSettings::default());
    assert!(other != run(Isa::Portable, false), "the comparison can fail");
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let camera = camera(100, 70);
    let scene: SplatTensors<f32> = cast(&splats(3000, -2.8, 6));
    let run = |threads| with_threads(threads, || color_run(&scene, &camera, Isa::best()));
    let expected = run(1);
    for threads in [2, 3, 8] {
        assert!(run(threads) == expected, "{threads} threads");
    }
}

#[test]
fn depth_and_features_leave_color_gradients_as_they_are() {
    let camera = camera(40, 40);
    let scene: SplatTensors<f32> = cast(&splats(200, -2.0, 7));
    let run = |depth| {
        let mut tape = Tape::new(Device::Cpu);
        let leaves = scene.leaves(&mut tape);
        let settings = RasterSettings { depth, ..RasterSettings::default() };
        let color = render(&mut tape, &leaves, None, &camera, &settings).unwrap().color;
        let seed = Tensor::full(tape.value(color).shape(), 1.0);
        let gradient = tape.backward(&[(color, seed)]).take(leaves.positions).unwrap();
        (tape.value(color).clone(), gradient)
    };
    let ((color, gradient), (color_with_depth, gradient_with_depth)) = (run(false), run(true));
    assert!(color == color_with_depth);
    check::agree(&gradient_with_depth, &gradient, 1e-6).unwrap();
}

#[test]
fn permuting_splats_permutes_gradients_and_keeps_the_image() {
    let camera = camera(60, 44);
    let scene: SplatTensors<f32> = cast(&splats(300, -2.2, 8));
    let permutation: Vec<usize> = (0..300).map(|index| index * 7 % 300).collect();
    let (images, gradients) = color_run(&scene, &camera, Isa::best());
    let (permuted_images, permuted) = color_run(&select(&scene, &permutation), &camera, Isa::best());
    assert!(images == permuted_images);
    let expected = select(&from_tensors(&gradients[..5]), &permutation);
    assert!(tensors(&expected) == permuted[..5]);
    assert!(gradients[0] != permuted[0], "the permutation does something");
}

#[test]
fn equal_depths_are_blended_by_index() {
    let camera = camera(32, 32);
    let mut scene: SplatTensors<f32> = select(&cast(&splats(100, -1.0, 9)), &[0; 100]);
    let sh = noise(100 * 48, 1).into_iter().map(|value| value as f32).collect();
    scene.sh = Tensor::from_vec([100, 16, 3], sh);
    let expected = with_threads(1, || color_run(&scene, &camera, Isa::best()));
    for threads in [1, 2, 3, 8, 16] {
        assert!(with_threads(threads, || color_run(&scene, &camera, Isa::best())) == expected);
    }
    let reversed: Vec<usize> = (0..100).rev().collect();
    assert!(color_run(&select(&scene, &reversed), &camera, Isa::best()).0 != expected.0, "order decides");
}

#[test]
fn culled_and_poisoned_splats_change_nothing_else() {
    let camera = camera(48, 40);
    let scene: SplatTensors<f32> = cast(&splats(60, -1.8, 10));
    let (image, gradients) = color_run(&scene, &camera, Isa::best());
    let behind_camera = {
        let mut positions = scene.positions.clone();
        positions.make_mut()[..3].copy_from_slice(&[1.2, 0.1, -30.0]);
        SplatTensors { positions, ..scene.clone() }
    };
    let poisons = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    // Every parameter in turn; −∞ as a scale or an opacity is a legal limit (a point, nothing) that need not be culled.
    let poisoned = (0..5).flat_map(|field| {
        let scene = &scene;
        poisons.into_iter().filter(move |poison| *poison != f32::NEG_INFINITY || ![1, 3].contains(&field)).map(
            move |poison| {
                let mut tensors = tensors(scene);
                tensors[field].make_mut()[0] = poison;
                (from_tensors(&tensors), format!("field {field} = {poison}"))
            },
        )
    });
    let others: Vec<usize> = (1..60).collect();
    let (expected_image, expected) = color_run(&select(&scene, &others), &camera, Isa::best());
    assert!(image != expected_image, "the first splat is visible");
    assert_ne!(gradients[0].row(0), [0.0; 3]);
    for (scene, what) in poisoned.chain([(behind_camera, "behind the camera".to_owned())]) {
        // +∞ as an opacity logit is an opacity of one, also legal.
        if what == "field 3 = inf" {
            continue;
        }
        let (found_image, found) = color_run(&scene, &camera, Isa::best());
        assert!(found_image == expected_image, "{what}");
        for (found, expected) in found.iter().zip(&expected) {
            let row_len = expected.row_len();
            assert!(found.as_slice()[..row_len].iter().all(|&value| value == 0.0), "{what}: exact zero gradient");
            assert!(found.as_slice()[row_len..] == *expected.as_slice(), "{what}: others bit-identical");
        }
    }
}

#[test]
fn nothing_visible_gives_the_background_and_no_gradient() {
    let camera = camera(17, 33);
    let settings = RasterSettings { background: [0.25, 0.5, 1.0], ..RasterSettings::default() };
    let mut behind: SplatTensors<f32> = cast(&splats(10, -2.0, 11));
    behind.positions.make_mut().chunks_exact_mut(3).for_each(|position| position[2] = -50.0);
    let mut outside: SplatTensors<f32> = cast(&splats(1, -4.0, 12));
    outside.positions.make_mut().copy_from_slice(&[100.0, 0.0, 0.0]);
    let empty = select(&behind, &[]);
    for scene in [behind, outside, empty] {
        let (images, gradients) = render_and_gradients(&scene, None, &camera, &settings);
        assert!(images[0].as_slice().chunks_exact(3).all(|pixel| pixel == settings.background));
        assert!(images[1].as_slice().iter().all(|&alpha| alpha == 0.0));
        assert!(gradients.iter().all(|gradient| gradient.as_slice().iter().all(|&value| value == 0.0)));
    }
}

#[test]
fn odd_image_sizes_agree_with_the_reference() {
    for (width, height) in [(1, 1), (1, 17), (17, 1), (15, 15), (16, 16), (17, 17), (33, 47), (97, 129), (257, 257)] {
        let camera = camera(width, height);
        let scene = splats(40, -1.7, 13);
        let (found, found_gradients) = color_run(&cast(&scene), &camera, Isa::best());
        let (expected, gradients) = render_and_gradients(&scene, None, &camera, &RasterSettings::default());
        check::agree(&found[0], &expected[0], MAX_FLIP).unwrap();
        for (found, expected) in found_gradients.iter().zip(&gradients) {
            check::agree(found, expected, 3e-3).unwrap();
        }
    }
}

#[test]
fn means_receive_the_gradient_that_moves_the_splats() {
    // A shift of the principal point moves every splat by the same number of pixels.
    let (mut camera, scene) = (camera(24, 24), splats(5, -1.5, 14));
    let objective = |camera: &PinholeCamera| {
        let (images, gradients) =
            render_and_gradients(&scene, None, camera, &RasterSettings { depth: false, ..smooth() });
        let weights = |index: usize| noise(images[index].len(), 77 + index as u64);
        let dot = |index: usize| {
            weights(index).iter().zip(images[index].as_slice()).map(|(weight, value)| weight * value).sum::<f64>()
        };
        (dot(0) + dot(1), gradients[5].clone())
    };
    let analytic: f64 = objective(&camera).1.as_slice().chunks_exact(2).map(|row| row[0]).sum();
    // The principal point also moves the clamp of the affine map; these splats lie inside it.
    let step = 1e-6;
    camera.center[0] += step;
    let above = objective(&camera).0;
    camera.center[0] -= 2.0 * step;
    let below = objective(&camera).0;
    let numeric = (above - below) / (2.0 * step);
    assert!((analytic - numeric).abs() <= 1e-6 * numeric.abs().max(1.0), "{analytic} {numeric}");
}

#[test]
fn statistics_count_what_was_rendered() {
    let scene: SplatTensors<f32> = cast(&splats(50, -2.0, 15));
    let mut tape = Tape::new(Device::Cpu);
    let vars = scene.constants(&mut tape);
    let rendered = render(&mut tape, &vars, None, &camera(40, 40), &RasterSettings::default()).unwrap();
    let stats = rendered.stats();
    assert_eq!(stats.visible, rendered.visible().iter().filter(|&&visible| visible).count());
    assert_eq!(stats.nominal_pixel_splats, 256 * stats.intersections as u64);
    let blended = stats.blended_pixel_splats.expect("counted on the CPU");
    assert!(blended > 0 && blended < stats.nominal_pixel_splats);
    assert!(
        rendered.radii_px(&tape).iter().zip(rendered.visible()).all(|(&radius, visible)| (radius > 0.0) == visible)
    );
    let names: Vec<&str> = tape.profile().ops.keys().copied().collect();
    assert_eq!(names, ["binning", "blending", "projection"]);
}

#[test]
fn images_without_gradient_are_the_same_images() {
    let (scene, camera): (SplatTensors<f32>, _) = (cast(&splats(80, -2.0, 16)), camera(50, 30));
    let settings = RasterSettings { depth: true, ..RasterSettings::default() };
    let image = render_image(&scene, &camera, &settings).unwrap();
    let (expected, _) = render_and_gradients(&scene, None, &camera, &settings);
    assert!([image.color, image.alpha, image.depth.unwrap()] == expected[..]);
}

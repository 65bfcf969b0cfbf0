use super::factors::factors;
use super::*;
use crate::check::{self, TOLERANCE, noise};
use crate::geometry::algebra::{Mat3, dot, product, rotation, scale_columns, transposed};
use crate::rasteriser::binning::TooManyIntersections;
use crate::rasteriser::render::scene_tests::{camera, cast, splats, tensors};
use crate::rasteriser::splats::SplatTensors;
use crate::tape::Device;

fn vars(vars: &[Var]) -> SplatVars {
    let &[positions, log_scales, rotations, opacity_logits, sh] = vars else { panic!("five variables") };
    SplatVars { positions, shape: ShapeVars::ScaleRotation { log_scales, rotations }, opacity_logits, sh }
}

fn view<T: Real>() -> View<T> {
    View::new(&camera(1000, 800), &RasterSettings::default())
}

fn shape<T>(log_scales: [T; 3], rotation: [T; 4]) -> Shape<T> {
    Shape::ScaleRotation { log_scales, rotation }
}

/// The parameters of a shape, or the gradients with respect to them.
fn scale_rotation<T: Real>(shape: Shape<T>) -> ([T; 3], [T; 4]) {
    let Shape::ScaleRotation { log_scales, rotation } = shape else { panic!("scales and rotation") };
    (log_scales, rotation)
}

/// An ordinary splat in front of [`camera`].
fn plain<T: Real>(sh: &[T]) -> Splat<'_, T> {
    let f = T::from_f64;
    Splat {
        position: [0.1, 0.2, -0.3].map(f),
        shape: shape([-2.0, -1.5, -3.0].map(f), [0.9, 0.1, -0.3, 0.2].map(f)),
        opacity_logit: f(0.5),
        sh,
    }
}

/// [`camera`] moved to the origin, looking along z: world and view coordinates are equal.
fn camera_at_origin(width: usize, height: usize) -> PinholeCamera {
    let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    PinholeCamera { rotation, translation: [0.0; 3], ..camera(width, height) }
}

/// The position at `view_position` in the view of [`camera`].
fn world_from_view(view_position: [f64; 3]) -> [f64; 3] {
    let camera = camera(1000, 800);
    let offset = [0, 1, 2].map(|axis| view_position[axis] - camera.translation[axis]);
    [0, 1, 2].map(|axis| (0..3).map(|row| camera.rotation[row][axis] * offset[row]).sum())
}

fn check_gradients(splats: &SplatTensors<f64>, camera: &PinholeCamera, degree: usize) {
    let settings = RasterSettings { sh_degree: degree, ..RasterSettings::default() };
    let outputs: [fn(&ProjectedVars) -> Var; 5] =
        [|p| p.means2d, |p| p.conics, |p| p.depths, |p| p.opacities, |p| p.colors];
    for output in outputs {
        let f = |tape: &mut Tape<f64>, inputs: &[Var]| output(&project(tape, &vars(inputs), camera, &settings));
        check::gradients(f, &tensors(splats), TOLERANCE).unwrap();
    }
}

#[test]
fn gradients_are_central_differences() {
    for degree in 0..=3 {
        check_gradients(&splats(4, -1.0, 20 + degree as u64), &camera(40, 30), degree);
    }
}

#[test]
fn gradients_are_central_differences_where_the_affine_map_is_clamped() {
    // One large splat inside the image, one beyond its right border, and one beyond its corner.
    let camera = camera(40, 30);
    for offset in [[0.0, 0.0], [2.4, 0.0], [2.4, 2.2]] {
        let mut splat = splats(1, 0.0, 30);
        let z = 4.0;
        splat.positions = Tensor::from_vec([1, 3], world_from_view([offset[0], offset[1], z]).to_vec());
        let slope = [offset[0] / z, offset[1] / z];
        let limit = [0, 1].map(|axis| (1.15 * [40.0, 30.0][axis] - camera.center[axis]) / camera.focal[axis]);
        assert_eq!([slope[0] > limit[0], slope[1] > limit[1]], [offset[0] > 0.0, offset[1] > 0.0]);
        check_gradients(&splat, &camera, 1);
    }
}

/// R_q·diag(eˢ) of one row of splats.
fn factor_of(splats: &SplatTensors<f64>, row: usize) -> Mat3<f64> {
    let (log_scales, raw) = (splats.log_scales.row(row), splats.rotations.row(row));
    let length = raw.iter().map(|value| value * value).sum::<f64>().sqrt();
    let unit = [0, 1, 2, 3].map(|at| raw[at] / length);
    scale_columns(&rotation(unit), [0, 1, 2].map(|axis| log_scales[axis].exp()))
}

/// The splats with another factor of the same covariances: every F turned by one rotation from the right.
fn factored(splats: &SplatTensors<f64>) -> Vec<Tensor<f64>> {
    let count = splats.positions.rows();
    let turn = transposed(&rotation([0.5, 0.5, -0.5, 0.5]));
    let factors = (0..count).flat_map(|row| product(&factor_of(splats, row), &turn).as_flattened().to_vec()).collect();
    let SplatTensors { positions, opacity_logits, sh, .. } = splats.clone();
    vec![positions, Tensor::from_vec([count, 3, 3], factors), opacity_logits, sh]
}

fn factored_vars(vars: &[Var]) -> SplatVars {
    let &[positions, factors, opacity_logits, sh] = vars else { panic!("four variables") };
    SplatVars { positions, shape: ShapeVars::Factor(factors), opacity_logits, sh }
}

#[test]
fn gradients_of_factors_are_central_differences() {
    let settings = RasterSettings { sh_degree: 1, ..RasterSettings::default() };
    for output in [|p: &ProjectedVars| p.means2d, |p: &ProjectedVars| p.conics, |p: &ProjectedVars| p.colors] {
        let f = |tape: &mut Tape<f64>, inputs: &[Var]| {
            output(&project(tape, &factored_vars(inputs), &camera(40, 30), &settings))
        };
        check::gradients(f, &factored(&splats(4, -1.0, 24)), TOLERANCE).unwrap();
    }
}

#[test]
fn any_factor_of_the_covariance_gives_the_same_splat() {
    let (splats, settings) = (splats(50, -1.0, 25), RasterSettings::default());
    let mut tape = Tape::new(Device::Cpu);
    let from_axes = splats.constants(&mut tape);
    let inputs: Vec<Var> = factored(&splats).into_iter().map(|tensor| tape.constant(tensor)).collect();
    let expected = project(&mut tape, &from_axes, &camera(100, 80), &settings);
    let found = project(&mut tape, &factored_vars(&inputs), &camera(100, 80), &settings);
    check::agree(tape.value(found.conics), tape.value(expected.conics), 1e-12).unwrap();
    assert_eq!(tape.value(found.colors), tape.value(expected.colors));
}

#[test]
fn factors_of_scales_and_rotations_are_those_that_projection_uses() {
    let splats = splats(6, -1.0, 26);
    let inputs = [splats.log_scales.clone(), splats.rotations.clone()];
    let f = |tape: &mut Tape<f64>, inputs: &[Var]| factors(tape, inputs[0], inputs[1]);
    check::gradients(f, &inputs, TOLERANCE).unwrap();
    let mut tape = Tape::new(Device::Cpu);
    let [log_scales, rotations] = inputs.map(|tensor| tape.constant(tensor));
    let found = factors(&mut tape, log_scales, rotations);
    for row in 0..6 {
        let expected = Tensor::from_vec([9], factor_of(&splats, row).as_flattened().to_vec());
        check::agree(&Tensor::from_vec([9], tape.value(found).row(row).to_vec()), &expected, 1e-12).unwrap();
    }
}

#[test]
fn factors_that_overflow_are_culled() {
    let sh = [0.0_f32; 48];
    let is_visible = |value: f32| {
        let factor = [[0.1, 0.0, 0.0], [0.0, 0.1, value], [0.0, 0.0, 0.1]];
        reference::project(&Splat { shape: Shape::Factor(factor), ..plain(&sh) }, &view()).is_some()
    };
    assert!(is_visible(0.0) && is_visible(-1.0));
    assert!([1e10, -1e10, f32::INFINITY, f32::NAN].into_iter().all(|value| !is_visible(value)));
}

#[test]
fn conics_are_positive_and_accurate_for_extreme_shapes() {
    let count = 100_000;
    let (shapes, quaternions, places) = (noise(3 * count, 1), noise(4 * count, 2), noise(3 * count, 3));
    // No translation, which would lose the digits of the smallest depths before the covariance is reached.
    let (camera, settings) = (camera_at_origin(1000, 800), RasterSettings::default());
    let (narrow, wide) = (View::<f32>::new(&camera, &settings), View::<f64>::new(&camera, &settings));
    let (narrow_sh, wide_sh) = ([0.0_f32; 48], [0.0_f64; 48]);
    let mut errors = Vec::new();
    for index in 0..count {
        let z = 0.51 + 0.49 * places[3 * index];
        let narrow_splat = Splat {
            position: [0.3 * z * places[3 * index + 1], 0.3 * z * places[3 * index + 2], z].map(|value| value as f32),
            shape: shape(
                [0, 1, 2].map(|axis| (-2.5 + 9.5 * shapes[3 * index + axis]) as f32),
                [0, 1, 2, 3].map(|axis| quaternions[4 * index + axis] as f32),
            ),
            opacity_logit: 2.0,
            sh: &narrow_sh,
        };
        // Equal numbers in both precisions, so that only the arithmetic differs.
        let (log_scales, rotation) = scale_rotation(narrow_splat.shape);
        let splat = Splat {
            position: narrow_splat.position.map(f64::from),
            shape: shape(log_scales.map(f64::from), rotation.map(f64::from)),
            opacity_logit: 2.0,
            sh: &wide_sh,
        };
        let (found, expected) = (reference::project(&narrow_splat, &narrow), reference::project(&splat, &wide));
        let (found, expected) = (found.expect("not culled").conic, expected.expect("not culled").conic);
        assert!(found[0] > 0.0 && found[2] > 0.0 && found[1].is_finite(), "{found:?}");
        // det = 1/(A·m) ≥ ε².
        let determinant = |conic: [f64; 3]| 1.0 / (conic[0] * conic[2]);
        assert!(determinant(found.map(f64::from)) >= 0.09 * (1.0 - 1e-5));
        errors.push((determinant(found.map(f64::from)) / determinant(expected) - 1.0).abs());
    }
    errors.sort_by(f64::total_cmp);
    assert!(errors[count * 99 / 100] <= 1e-5, "99 % within {:e}", errors[count * 99 / 100]);
    assert!(errors[count - 1] <= 1e-2, "all within {:e}", errors[count - 1]);
}

#[test]
fn a_line_has_finite_conic_and_gradient() {
    let sh = [0.0_f32; 48];
    let line = Splat { shape: shape([-20.0, -20.0, 0.0], [0.9, 0.1, -0.3, 0.2]), ..plain(&sh) };
    let upstream = Projected { conic: [1.0, 1.0, 1.0], mean2d: [1.0, 1.0], ..Projected::default() };
    let gradient = reference::backward(&line, &view(), &upstream, &mut [0.0; 48]).unwrap();
    let (log_scales, rotation) = scale_rotation(gradient.shape);
    let all = gradient.position.iter().chain(&log_scales).chain(&rotation);
    assert!(all.chain([&gradient.opacity_logit]).all(|value| value.is_finite()));

    let mut splat = splats(1, 0.0, 31);
    splat.log_scales = Tensor::from_vec([1, 3], vec![-20.0, -20.0, 0.0]);
    check_gradients(&splat, &camera(40, 30), 0);
}

#[test]
fn only_depths_between_near_and_far_are_projected() {
    let sh = [0.0_f32; 48];
    let settings = RasterSettings { near_view: 0.5, far_view: 10.0, ..RasterSettings::default() };
    let view = View::<f32>::new(&camera_at_origin(100, 100), &settings);
    let at = |z: f32| reference::project(&Splat { position: [0.0, 0.0, z], ..plain(&sh) }, &view).is_some();
    for z in [-1.0, 0.0, 0.5_f32.next_down(), 10.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert!(!at(z), "{z}");
    }
    for z in [0.5, 3.0, 10.0_f32.next_down()] {
        assert!(at(z), "{z}");
    }
}

#[test]
fn faint_and_exploded_splats_are_culled() {
    let sh = [0.0_f32; 48];
    let logit = |opacity: f32| (opacity / (1.0 - opacity)).ln();
    let is_visible = |splat: Splat<f32>| reference::project(&splat, &view()).is_some();
    assert!(is_visible(Splat { opacity_logit: logit(1.01 / 255.0), ..plain(&sh) }));
    assert!(!is_visible(Splat { opacity_logit: logit(0.5 / 255.0), ..plain(&sh) }));
    assert!(is_visible(Splat { shape: shape([10.0, 0.0, 0.0], [0.9, 0.1, -0.3, 0.2]), ..plain(&sh) }));
    for scale in [40.0, 100.0, f32::INFINITY, f32::NAN] {
        assert!(!is_visible(Splat { shape: shape([0.0, scale, 0.0], [0.9, 0.1, -0.3, 0.2]), ..plain(&sh) }), "{scale}");
    }
}

#[test]
fn saturated_opacities_keep_their_derivative() {
    let sh = [0.0_f64; 48];
    let derivative = |logit: f64| {
        let upstream = Projected { opacity: 1.0_f32, ..Projected::default() };
        let narrow = [0.0_f32; 48];
        let splat = Splat { opacity_logit: logit as f32, ..plain(&narrow) };
        reference::backward(&splat, &view(), &upstream, &mut [0.0; 48]).unwrap().opacity_logit
    };
    assert!((f64::from(derivative(20.0)) / (-20.0_f64).exp() - 1.0).abs() <= 1e-5);
    assert!([30.0, -30.0, 200.0, -200.0].iter().all(|&logit| derivative(logit).is_finite()));
    let opaque = reference::project(&Splat { opacity_logit: 30.0, ..plain(&sh) }, &view()).unwrap();
    assert!((opaque.opacity - 1.0).abs() <= 1e-12);
}

#[test]
fn quaternions_have_a_direction_only() {
    let sh = [0.0_f64; 48];
    let turned = |rotation| Splat { shape: shape([-2.0, -1.5, -3.0], rotation), ..plain(&sh) };
    let project = |rotation: [f64; 4]| reference::project(&turned(rotation), &view()).unwrap();
    let q = [0.3, -0.8, 0.4, 0.1];
    for (a, b) in project(q).conic.iter().zip(project(q.map(|value| 40.0 * value)).conic) {
        assert!((a - b).abs() <= 1e-12 * a.abs());
    }
    assert_eq!(project([0.0; 4]), project([1.0, 0.0, 0.0, 0.0]), "no direction is no rotation");

    let upstream = Projected { conic: [0.3, -0.7, 0.2], ..Projected::default() };
    let gradient = |rotation| {
        scale_rotation(reference::backward(&turned(rotation), &view(), &upstream, &mut [0.0; 48]).unwrap().shape).1
    };
    let radial: f64 = gradient(q).iter().zip(q).map(|(gradient, q)| gradient * q).sum();
    let norm: f64 = gradient(q).iter().map(|value| value * value).sum::<f64>().sqrt();
    assert!(radial.abs() <= 1e-12 * norm && norm > 0.0);
    assert_eq!(gradient([0.0; 4]), [0.0; 4]);
}

#[test]
fn rotations_are_orthonormal_and_right_handed() {
    let [x, y, z] = rotation([0.5, 0.5, 0.5, 0.5_f64]);
    assert_eq!([x, y, z], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    assert_eq!(dot(crate::geometry::algebra::cross(x, y), z), 1.0);
}

#[test]
fn a_splat_at_the_camera_center_is_finite() {
    // Only reachable with a near plane at almost zero; the direction guard alone must suffice.
    let sh = noise(48, 3);
    let camera = camera(100, 100);
    let splat = Splat { position: camera.position_world(), ..plain(&sh) };
    let settings = RasterSettings { near_view: 1e-300, ..RasterSettings::default() };
    assert!(reference::project(&splat, &View::new(&camera, &settings)).is_none_or(|splat| splat.depth.is_finite()));
}

#[test]
fn a_colour_below_zero_is_black_without_gradient() {
    let mut sh = [0.0_f64; 48];
    sh[..3].copy_from_slice(&[-5.0, 0.0, 1.0]);
    let projected = reference::project(&plain(&sh), &view()).unwrap();
    assert_eq!(projected.color[..2], [0.0, 0.5]);
    let upstream = Projected { color: [1.0; 3], ..Projected::default() };
    let mut gradient = [0.0; 48];
    reference::backward(&plain(&sh), &view(), &upstream, &mut gradient).unwrap();
    assert_eq!(gradient[0], 0.0);
    assert!(gradient[1] > 0.0 && gradient[2] > 0.0);
}

#[test]
fn scene_cameras_convert() {
    use scene::camera::{Camera, Intrinsics};
    let intrinsics =
        Intrinsics { width: 640, height: 480, focal_x: 500.0, focal_y: 510.0, center_x: 321.0, center_y: 239.0 };
    let camera = Camera::look_at(intrinsics, [1.0, 2.0, 3.0].into(), [0.0; 3].into(), [0.0, 0.0, 1.0].into());
    let pinhole = PinholeCamera::from(&camera);
    for (found, expected) in pinhole.position_world().into_iter().zip([1.0, 2.0, 3.0]) {
        assert!((found - expected).abs() <= 1e-12);
    }
    let (pixel, depth) = camera.project([0.3, -0.1, 0.2].into()).unwrap();
    let sh = [0.0; 48];
    let splat = Splat { position: [0.3, -0.1, 0.2], ..plain(&sh) };
    let projected = reference::project(&splat, &View::new(&pinhole, &RasterSettings::default())).unwrap();
    assert!((projected.mean2d[0] - pixel.x).abs() <= 1e-9 && (projected.mean2d[1] - pixel.y).abs() <= 1e-9);
    assert!((projected.depth - depth).abs() <= 1e-12);
}

#[test]
fn f32_agrees_with_f64() {
    let scene = splats(500, -2.0, 33);
    fn outputs<T: Real>(scene: &SplatTensors<T>) -> Vec<Tensor<T>> {
        let mut tape = Tape::new(Device::Cpu);
        let vars = scene.constants(&mut tape);
        let p = project(&mut tape, &vars, &camera(100, 80), &RasterSettings::default());
        [p.means2d, p.conics, p.depths, p.opacities, p.colors, p.cutoffs].map(|var| tape.value(var).clone()).into()
    }
    for (found, expected) in outputs::<f32>(&cast(&scene)).iter().zip(outputs(&scene)) {
        check::agree(found, &expected, 5e-6).unwrap();
    }
}

#[test]
fn an_impossible_render_says_so() {
    let message = TooManyIntersections { count: 1 << 40 }.to_string();
    assert!(message.contains("hint"), "{message}");
}

use super::*;
use crate::check::conformance::Disagreement;
use crate::check::{agree, noise};
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::rasteriser::render::render;
use crate::rasteriser::render::scene_tests::{camera, cast, splats};
use crate::rasteriser::settings::RasterSettings;
use crate::tape::Device;

/// Renders of 300 splats at several sizes on a device, and their gradients.
fn rendered_on(device: Device, renders: usize) -> (Tape<f32>, Vec<Rendered>, Gradients<f32>) {
    let mut tape = Tape::new(device);
    let leaves = cast::<f32>(&splats(300, -2.0, 3)).leaves(&mut tape);
    let render = |index: usize, tape: &mut Tape<f32>| {
        render(tape, &leaves, None, &camera(40 + 8 * index, 30), &RasterSettings::default()).unwrap()
    };
    let rendered: Vec<Rendered> = (0..renders).map(|index| render(index, &mut tape)).collect();
    let seed = |rendered: &Rendered| {
        let color = tape.value(rendered.color);
        let weights = noise(color.len(), 5).into_iter().map(|weight| weight as f32).collect();
        (rendered.color, Tensor::from_vec(color.shape(), weights))
    };
    let seeds: Vec<_> = rendered.iter().map(seed).collect();
    let gradients = tape.backward(&seeds);
    (tape, rendered, gradients)
}

/// The row of each splat in a population of 400; the last splats belong to none.
fn some_rows() -> Vec<u32> {
    (0..290).map(|splat| splat * 7 % 397).collect()
}

/// The reference, on the host.
fn expected(
    renders: usize,
    rows: Option<&[u32]>,
    step_gradient: StepGradient,
    statistics: &Tensor<f32>,
) -> Tensor<f32> {
    let (tape, rendered, gradients) = rendered_on(Device::Cpu, renders);
    let mut values: Vec<f32> = statistics.as_slice().to_vec();
    let seen: Vec<_> = rendered.iter().map(|render| (render.visible(), render.radii_px(&tape))).collect();
    for (at, row) in values.as_chunks_mut::<3>().0.iter_mut().enumerate() {
        let of_row = |rows: &[u32]| rows.iter().position(|&row| row as usize == at);
        let Some(splat) = rows.map_or(Some(at), of_row) else { continue };
        let (mut sum, mut norms, mut shown) = ([0.0_f32; 2], 0.0, 0.0);
        for (index, (render, (visible, radii))) in rendered.iter().zip(&seen).enumerate() {
            if visible[splat] {
                let gradient = gradients.get(render.means2d).unwrap().row(splat);
                let ndc = [gradient[0] * (20 + 4 * index) as f32, gradient[1] * 15.0];
                sum = [sum[0] + ndc[0], sum[1] + ndc[1]];
                norms += ndc[0].hypot(ndc[1]);
                shown += 1.0_f32;
                row[2] = row[2].max(radii[splat]);
            }
        }
        row[0] += match step_gradient {
            StepGradient::OfSum => sum[0].hypot(sum[1]),
            StepGradient::MeanOverViews => norms * renders as f32 / shown.max(1.0),
        };
        row[1] += shown.min(1.0);
    }
    Tensor::from_vec(statistics.shape(), values)
}

fn compare(renders: usize, rows: Option<&[u32]>) -> Result<usize, Disagreement> {
    compare_rows(renders, rows, if rows.is_some() { 400 } else { 300 }, StepGradient::OfSum)
}

fn compare_views(renders: usize, rows: Option<&[u32]>) -> Result<usize, Disagreement> {
    compare_rows(renders, rows, if rows.is_some() { 400 } else { 300 }, StepGradient::MeanOverViews)
}

/// The statistics of `count` rows.
fn compare_rows(
    renders: usize,
    rows: Option<&[u32]>,
    count: usize,
    step_gradient: StepGradient,
) -> Result<usize, Disagreement> {
    let Some(gpu) = test_gpu() else { return Ok(0) };
    let values = noise(3 * count, 9).into_iter().map(|value| (1.0 + value) as f32).collect();
    let before = Tensor::from_vec([count, 3], values);
    let (tape, rendered, gradients) = rendered_on(Device::Gpu(gpu), renders);
    let render =
        |(index, rendered)| PopulationRender { rendered, size_px: [(40 + 8 * index) as f64, 30.0], row_of_splat: rows };
    let of_population: Vec<PopulationRender> = rendered.iter().enumerate().map(render).collect();
    let found = observe(&tape, &gradients, &of_population, step_gradient, &before).expect("on a GPU");
    let what = format!("the statistics of {renders} renders, {step_gradient:?}");
    agree(&found, &expected(renders, rows, step_gradient, &before), 2e-3)
        .map(|()| 1)
        .map_err(|mismatch| Disagreement { what, mismatch })
}

#[test]
fn the_kernel_is_valid() {
    for (first, last, rows, views) in [(0, 0, 0, 1), (0, 1, 1, 0), (1, 0, 0, 0), (1, 1, 1, 1)] {
        assert_valid::<ViewBlock>(&SCREEN, &[("FIRST", first), ("LAST", last), ("ROWS", rows), ("VIEWS", views)]);
    }
}

#[test]
fn gpu_statistics_equal_the_hosts() {
    for renders in [1, 2, 3] {
        compare(renders, None).unwrap_or_else(|error| panic!("{error}"));
        compare(renders, Some(&some_rows())).unwrap_or_else(|error| panic!("{error}"));
        compare_views(renders, None).unwrap_or_else(|error| panic!("{error}"));
        compare_views(renders, Some(&some_rows())).unwrap_or_else(|error| panic!("{error}"));
        // Splats past the last row are ignored.
        compare_rows(renders, None, 260, StepGradient::OfSum).unwrap_or_else(|error| panic!("{error}"));
    }
}

#[test]
fn faults_are_noticed() {
    if test_gpu().is_none() {
        return;
    }
    let wrong =
        [("min(sum.z, 1.0)", "sum.z"), ("* view.half_width", ""), ("k * k / m", "k / m"), ("FIRST == 0u", "true")];
    assert_noticed(&wrong.map(|(right, wrong)| (SCREEN.name, right, wrong)), || compare(2, None));
    assert_noticed(&[(SCREEN.name, "splat_of_row[row]", "row")], || compare(1, Some(&some_rows())));
    let of_views = [("* view.renders", ""), ("/ max(sum.z, 1.0)", ""), ("gradient_y * gradient_y", "0.0")];
    assert_noticed(&of_views.map(|(right, wrong)| (SCREEN.name, right, wrong)), || compare_views(2, None));
}

#[test]
fn renders_on_the_host_yield_none() {
    let (tape, rendered, gradients) = rendered_on(Device::Cpu, 1);
    let render = PopulationRender { rendered: &rendered[0], size_px: [40.0, 30.0], row_of_splat: None };
    assert!(observe(&tape, &gradients, &[render], StepGradient::OfSum, &Tensor::zeros([300, 3])).is_none());
}

use super::*;
use crate::blending::tests::{Scene, blend_vars};
use crate::check::{agree, noise};
use crate::gpu::conformance::{Disagreement, run};
use crate::gpu::fault::assert_noticed;
use crate::gpu::layout::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::tape::{Device, Tape, Var};

/// Ellipses of all sizes, from dots to needles across the image.
fn ellipses(count: usize, [width, height]: [usize; 2], seed: u64) -> Scene {
    let random = noise(6 * count, seed);
    let rows = random.as_chunks::<6>().0;
    let conic = |&[_, _, long, short, turn, _]: &[f64; 6]| {
        // Standard deviations from a third of a pixel to 150 px; 0.3 as projections add.
        let [long, short] = [long, short].map(|value| 7.0_f64.powf(2.0 * value + 0.5 * (value + 1.0)));
        let (sin, cos) = (3.2 * turn).sin_cos();
        let x = (long * cos).powi(2) + (short * sin).powi(2) + 0.3;
        let y = (long * sin).powi(2) + (short * cos).powi(2) + 0.3;
        let covariance = (long * long - short * short) * sin * cos;
        [1.0 / (x - covariance * covariance / y), -covariance / y, 1.0 / y]
    };
    let mean = |&[x, y, ..]: &[f64; 6]| [(0.5 + 0.6 * x) * width as f64, (0.5 + 0.6 * y) * height as f64];
    Scene {
        means2d: rows.iter().map(mean).collect(),
        conics: rows.iter().map(conic).collect(),
        opacities: rows.iter().map(|row| 0.5 + 0.495 * row[5]).collect(),
        colors: noise(3 * count, seed + 1).as_chunks().0.to_vec(),
    }
}

/// What makes the images of a scene from its inputs.
type BlendFn = Box<dyn Fn(&mut Tape<f32>, &[Var]) -> Vec<Var>>;

/// Inputs of a scene with two features, and what blends them with depth.
fn blending(scene: &Scene, size: [usize; 2], settings: RasterSettings) -> (Vec<Tensor<f32>>, BlendFn) {
    let mut inputs = scene.tensors().to_vec();
    let count = inputs[0].rows();
    inputs.push(Tensor::from_vec([count, 2], noise(2 * count, 5)).cast());
    let settings = RasterSettings { depth: true, background: [0.3, 0.1, 0.6], ..settings };
    let blend = move |tape: &mut Tape<f32>, vars: &[Var]| {
        let blended = blend_vars(tape, &vars[..4], Some(vars[4]), size, &settings);
        vec![blended.color, blended.alpha, blended.depth.unwrap(), blended.features.unwrap()]
    };
    (inputs, Box::new(blend))
}

/// Compares what a GPU finds by a changed plan with what it finds by its own, to the last bit.
fn compare_plans(gpu: Gpu, scene: &Scene, size: [usize; 2], change: fn(&mut Plan)) -> Result<usize, Disagreement> {
    let (inputs, blend) = blending(scene, size, RasterSettings::default());
    let found = run(Device::Gpu(gpu), &inputs, &blend);
    let expected = Plan::changed(change, || run(Device::Gpu(gpu), &inputs, &blend));
    for ((name, found), (_, expected)) in found.iter().zip(&expected) {
        let disagreement = |mismatch| Disagreement { what: format!("{name} of {size:?}"), mismatch };
        agree(found, expected, 0.0).map_err(disagreement)?;
    }
    Ok(found.len())
}

#[test]
fn kernels_are_valid_for_every_kind_of_channel() {
    for (extras, depth) in [(0, 0), (1, 0), (1, 1), (9, 1), (16, 0)] {
        let (extras, depth, smooth) = (("EXTRAS", extras), ("DEPTH", depth), ("SMOOTH", depth));
        let culled = ("CULLED", 1 - depth.1);
        assert_valid::<PackBlock>(&PACK, &[depth]);
        assert_valid::<BlendBlock>(&FORWARD, &[extras, depth, smooth, culled, ("BATCH", BATCH)]);
        assert_valid::<BlendBlock>(&BACKWARD, &[extras, depth, smooth, ("ARRIVING", 0b1011)]);
        assert_valid::<SumBlock>(&SUM, &[extras, depth]);
    }
}

#[test]
fn skipping_what_a_cell_does_not_meet_changes_nothing() {
    let Some(gpu) = test_gpu() else { return };
    let everything = |plan: &mut Plan| plan.is_culled = false;
    for (count, size) in [(0, [20, 20]), (1, [1, 1]), (300, [17, 33]), (3000, [97, 130]), (700, [500, 16])] {
        for seed in [1, 20] {
            compare_plans(gpu, &ellipses(count, size, seed), size, everything).unwrap();
        }
    }
    let scene = ellipses(300, [60, 40], 3);
    let faults = [
        ("blending", "top + f32(CELL_HEIGHT - 1u)", "top"),
        ("blending", "1u << (2u * row + column)", "1u << (row + 4u * column)"),
        ("blending", "shadow.x > first + f32(CELL_WIDTH - 1u)", "shadow.x > first"),
    ];
    assert_noticed(&faults, || compare_plans(gpu, &scene, [60, 40], everything));
}

use super::backward::{IN_SUBGROUPS, IN_WORKGROUPS, SUM, SumBlock, subgroup_batch};
use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare, run};
use crate::check::{agree, noise};
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::{assert_valid, assert_valid_with_subgroups};
use crate::gpu::tests::test_gpu;
use crate::rasteriser::blending::tests::{Scene, blend_vars};
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

/// Renders the images of a scene from its inputs.
type BlendFn = Box<dyn Fn(&mut Tape<f32>, &[Var]) -> Vec<Var>>;

/// Inputs of a scene with `features` features, and a function that blends them with depth.
fn blending(
    (scene, features): (&Scene, usize),
    size: [usize; 2],
    settings: RasterSettings,
) -> (Vec<Tensor<f32>>, BlendFn) {
    let mut inputs = scene.tensors().to_vec();
    let count = inputs[0].rows();
    inputs.push(Tensor::from_vec([count, features], noise(features * count, 5)).cast());
    let settings = RasterSettings { depth: true, background: [0.3, 0.1, 0.6], ..settings };
    let blend = move |tape: &mut Tape<f32>, vars: &[Var]| {
        let blended = blend_vars(tape, &vars[..4], Some(vars[4]), size, &settings);
        vec![blended.color, blended.alpha, blended.depth.unwrap(), blended.features.unwrap()]
    };
    (inputs, Box::new(blend))
}

/// Sums over hundreds of splats and pixels.
const TIGHT: Tolerance = Tolerance { value: 1e-4, gradient: 1e-3 };

/// The variants that sum over pixels.
const WAYS: [fn(&mut Plan); 2] = [in_subgroups, in_workgroups];

fn in_subgroups(_: &mut Plan) {}

fn in_workgroups(plan: &mut Plan) {
    plan.subgroup = None;
}

/// Compares a GPU under a changed plan with the CPU, with smooth thresholds.
fn compare_with_cpu(
    gpu: Gpu,
    scene: (&Scene, usize),
    size: [usize; 2],
    change: fn(&mut Plan),
) -> Result<usize, Disagreement> {
    let settings = RasterSettings { smooth_cutoff: true, transmittance_stop: 0.0, ..RasterSettings::default() };
    let (inputs, blend) = blending(scene, size, settings);
    Plan::changed(change, || compare(gpu, &format!("{size:?}"), &inputs, TIGHT, blend))
}

/// Compares two plans on a GPU bit for bit.
fn compare_plans(
    gpu: Gpu,
    scene: &Scene,
    size: [usize; 2],
    changes: [fn(&mut Plan); 2],
) -> Result<usize, Disagreement> {
    let (inputs, blend) = blending((scene, 2), size, RasterSettings::default());
    let [found, expected] = changes.map(|change| Plan::changed(change, || run(Device::Gpu(gpu), &inputs, &blend)));
    for ((name, found), (_, expected)) in found.iter().zip(&expected) {
        let disagreement = |mismatch| Disagreement { what: format!("{name} of {size:?}"), mismatch };
        agree(found, expected, 0.0).map_err(disagreement)?;
    }
    Ok(found.len())
}

#[test]
fn kernels_are_valid_for_every_kind_of_channel() {
    for (extras, depth) in [(0, 0), (1, 0), (1, 1), (7, 1), (9, 1), (16, 0)] {
        let channels = [("EXTRAS", extras), ("DEPTH", depth), ("SMOOTH", depth)];
        let specialised = |batch| [&channels[..], &[("CULLED", 1 - depth), ("BATCH", batch)]].concat();
        let arriving = |batch| [&specialised(batch)[..], &[("ARRIVING", 0b1011)]].concat();
        assert_valid::<PackBlock>(&PACK, &channels[1..2]);
        assert_valid::<BlendBlock>(&FORWARD, &specialised(BATCH));
        assert_valid::<BlendBlock>(&IN_WORKGROUPS, &arriving(32));
        assert_valid::<SumBlock>(&SUM, &[&channels[..2], &[("LANES", 9 + extras)]].concat());
        for subgroup in [4, 8, 16, 32, 64, 128] {
            let batch = subgroup_batch(subgroup, 9 + extras as usize).expect("it fits");
            let specialisation = [&arriving(batch)[..], &[("SUBGROUP", subgroup)]].concat();
            assert_valid_with_subgroups::<BlendBlock>(&IN_SUBGROUPS, &specialisation);
        }
    }
}

#[test]
fn as_many_entries_are_staged_as_fit() {
    assert_eq!([4, 8, 32, 64, 128].map(|subgroup| subgroup_batch(subgroup, 9)), [4, 8, 32, 32, 32].map(Some));
    assert_eq!([22, 96, 97].map(|row_len| subgroup_batch(8, row_len)), [Some(4), Some(1), None]);
}

#[test]
fn skipping_what_a_cell_does_not_meet_changes_nothing() {
    let Some(gpu) = test_gpu() else { return };
    let ways: [[fn(&mut Plan); 2]; 2] = [
        [in_subgroups, |plan| plan.is_culled = false],
        [in_workgroups, |plan| (plan.is_culled, plan.subgroup) = (false, None)],
    ];
    for (count, size) in [(0, [20, 20]), (1, [1, 1]), (300, [17, 33]), (900, [97, 50]), (300, [200, 16])] {
        for seed in [1, 20] {
            let scene = ellipses(count, size, seed);
            ways.iter().for_each(|&way| assert!(compare_plans(gpu, &scene, size, way).is_ok()));
        }
    }
    for kernel in ["blending", "blending backward"] {
        let scene = ellipses(300, [60, 40], 3);
        let faults = [
            (kernel, "top + f32(CELL_HEIGHT - 1u)", "top"),
            (kernel, "1u << (2u * row + column)", "1u << (row + 4u * column)"),
            (kernel, "shadow.x > first + f32(CELL_WIDTH - 1u)", "shadow.x > first"),
        ];
        assert_noticed(&faults, || compare_plans(gpu, &scene, [60, 40], ways[0]));
    }
}

#[test]
fn all_ways_of_adding_up_agree_with_the_cpu() {
    let Some(gpu) = test_gpu() else { return };
    for way in WAYS {
        for (count, size) in [(0, [20, 20]), (1, [1, 1]), (5, [16, 1]), (200, [17, 33]), (400, [64, 48])] {
            compare_with_cpu(gpu, (&ellipses(count, size, 7), 2), size, way).unwrap();
        }
        // Rows of 11, 16, 23 and 110 columns: the last are too long for parts of them to lie side by side.
        for features in [1, 6, 13, 100] {
            compare_with_cpu(gpu, (&ellipses(60, [20, 20], 9), features), [20, 20], way).unwrap();
        }
    }
    let wrong_columns = ("blending backward", "first_column + 4u * four", "4u * four");
    let many = ellipses(30, [20, 20], 9);
    assert_noticed(&[wrong_columns], || compare_with_cpu(gpu, (&many, 13), [20, 20], in_workgroups));
    let scene = ellipses(100, [40, 36], 8);
    let mut faults = vec![
        ("blending backward", "remaining / (1.0 - opacity.alpha)", "remaining"),
        ("blending backward", "before + entry < (*pixel).last", "before + entry + 2u < (*pixel).last"),
        ("blending backward", "2u + 4u * tail", "3u + 4u * tail"),
    ];
    let parts = [
        ("blending backward", "part < PARTS", "part < PARTS - 1u"),
        (
            "blending backward",
            "share.v * vec2<f32>(offset.y, offset.y * offset.y)",
            "share.v * vec2<f32>(offset.y, offset.x * offset.y)",
        ),
    ];
    assert_noticed(&[&faults[..], &parts].concat(), || compare_with_cpu(gpu, (&scene, 2), [40, 36], in_workgroups));
    if gpu.subgroup_size().is_none() {
        support::skip("the adapter has no subgroups of one size");
        return;
    }
    faults.extend([
        ("blending backward", "subgroup < SUBGROUPS; subgroup++", "subgroup + 1u < SUBGROUPS; subgroup++"),
        ("blending backward", "exchanged(given, distance / 2u)", "exchanged(given, distance)"),
        ("blending backward", "by_dy, by_dy * offset.y", "by_dy, by_dy * offset.x"),
    ]);
    assert_noticed(&faults, || compare_with_cpu(gpu, (&scene, 2), [40, 36], in_subgroups));
}

#[test]
fn every_way_of_adding_up_gives_equal_bytes_twice() {
    let Some(gpu) = test_gpu() else { return };
    let scene = ellipses(500, [70, 50], 4);
    for way in WAYS {
        assert!((0..3).all(|_| compare_plans(gpu, &scene, [70, 50], [way; 2]).is_ok()));
    }
}

/// Eight sums and four sums over each subgroup of a workgroup. Subgroups of any size are emulated in workgroup memory, so
/// that the sums are tested for sizes that the adapter lacks.
const SUMS: &str = "
#import rasteriser::blending::subgroup_sum
var<private> invocation: u32;
var<workgroup> given: array<vec4<f32>, 256>;
fn exchanged4(value: vec4<f32>, distance: u32) -> vec4<f32> {
    workgroupBarrier();
    given[invocation] = value;
    workgroupBarrier();
    return given[invocation ^ distance];
}
fn exchanged2(value: vec2<f32>, distance: u32) -> vec2<f32> {
    return exchanged4(vec4<f32>(value, 0.0, 0.0), distance).xy;
}
fn exchanged(value: f32, distance: u32) -> f32 {
    return exchanged4(vec4<f32>(value), distance).x;
}

struct Sums { invocations: u32 }
@group(0) @binding(0) var<uniform> sizes: Sums;
@group(0) @binding(1) var<storage, read> values: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> sums: array<vec2<f32>>;
@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    invocation = local;
    let lane = local % SUBGROUP;
    var eighth = 0.0;
    if (SUBGROUP >= 8u) {
        eighth = added8(lane, values[3u * local], values[3u * local + 1u]);
    }
    sums[local % sizes.invocations] = vec2<f32>(eighth, added4(lane, values[3u * local + 2u], SUBGROUP / 2u));
}
";
const ADDING: Kernel = Kernel { name: "sums over subgroups", text: SUMS };

uniforms! {
    struct SumsBlock as "Sums" { invocations: u32 }
}

#[test]
fn sums_over_subgroups_of_every_size_are_right() {
    let Some(gpu) = test_gpu() else { return };
    // Whole numbers, so that every sum is exact.
    let values: Vec<f32> = noise(256 * 12, 3).iter().map(|value| (100.0 * value).round() as f32).collect();
    let given = GpuArray::upload(gpu, &values);
    for subgroup in [4_usize, 8, 16, 32, 64, 128] {
        assert_valid::<SumsBlock>(&ADDING, &[("SUBGROUP", subgroup as u32)]);
        let sums = GpuArray::new(gpu, 2 * 256);
        let arrays = [Binding::Read(&given), Binding::Write(&sums)];
        ADDING.launch(gpu, &[("SUBGROUP", subgroup as u32)], &SumsBlock { invocations: 256 }, &arrays, 1);
        let mut found = vec![0.0_f32; 512];
        sums.read_into(&mut found);
        for (invocation, &[eighth, quarter]) in found.as_chunks::<2>().0.iter().enumerate() {
            let (first, lane) = (invocation / subgroup * subgroup, invocation % subgroup);
            let sum = |column: usize| (first..first + subgroup).map(|at| values[12 * at + column]).sum::<f32>();
            assert!(subgroup < 8 || eighth == sum(lane / (subgroup / 8)), "{subgroup}: {invocation}");
            assert_eq!(quarter, sum(8 + lane / (subgroup / 4)), "{subgroup}: {invocation}");
        }
    }
}

// How often splats were culled for their numbers, and numbers kept in range.

struct Limits {
    size_px: vec2<f32>,
    alpha_cap: f32,
    count: u32,
}

@group(0) @binding(0) var<uniform> limits: Limits;
@group(0) @binding(1) var<storage, read> cutoffs: array<f32>;
@group(0) @binding(2) var<storage, read> means2d: array<f32>;
@group(0) @binding(3) var<storage, read> opacities: array<f32>;
@group(0) @binding(4) var<storage, read> colors: array<f32>;
@group(0) @binding(5) var<storage, read_write> counts: array<atomic<u32>>;

// How far beyond the image, in images, means may lie.
const MARGIN: f32 = 0.15;

var<workgroup> partial: array<atomic<u32>, 6>;

// Whole numbers: the order of additions does not matter.
fn note(what: u32, times: u32) {
    if (times > 0u) {
        atomicAdd(&partial[what], times);
    }
}

fn is_within(splat: u32, axis: u32) -> bool {
    let at = means2d[2u * splat + axis] / limits.size_px[axis];
    return at >= -MARGIN && at <= 1.0 + MARGIN;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    if (local < 6u) {
        atomicStore(&partial[local], 0u);
    }
    workgroupBarrier();
    let splat = flat_group(group, groups) * 256u + local;
    if (splat < limits.count) {
        let cutoff = cutoffs[splat];
        note(0u, u32(cutoff == -2.0));
        note(1u, u32(cutoff == -3.0));
        note(2u, u32(cutoff == -4.0));
        note(4u, u32(opacities[splat] > limits.alpha_cap));
        if (cutoff >= 0.0) {
            note(3u, u32(!(is_within(splat, 0u) && is_within(splat, 1u))));
            var dark = 0u;
            for (var channel = 0u; channel < 3u; channel++) {
                dark += u32(colors[3u * splat + channel] == 0.0);
            }
            note(5u, dark);
        }
    }
    workgroupBarrier();
    if (local < 6u) {
        let sum = atomicLoad(&partial[local]);
        if (sum > 0u) {
            atomicAdd(&counts[local], sum);
        }
    }
}

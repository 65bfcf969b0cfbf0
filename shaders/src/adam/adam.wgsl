// One Adam update of every element of every parameter group: m ← β1·m + (1 − β1)·g, v ← β2·v + (1 − β2)·g²,
// p ← p − step·m / (√v·scale + ε). Also records the largest magnitudes of each group's gradient and of its new values.
#import gpu::flat_group
#import gpu::grouped::grouped
#const ELEMENTS
#extern fn gradients(item: u32, at: u32) -> f32
#extern fn values(item: u32, at: u32) -> f32
#extern fn first_moments(item: u32, at: u32) -> f32
#extern fn second_moments(item: u32, at: u32) -> f32
#extern fn set_new_values(item: u32, at: u32, value: f32)
#extern fn set_new_first_moments(item: u32, at: u32, value: f32)
#extern fn set_new_second_moments(item: u32, at: u32, value: f32)

struct Item {
    beta1: f32,
    beta2: f32,
    step_size: f32,
    second_moment_scale: f32,
    epsilon: f32,
    len: u32,
    // Index of the group's two maxima in `largest`.
    maxima: u32,
}

@group(0) @binding(1) var<storage, read_write> largest: array<atomic<u32>>;

var<workgroup> own_largest: array<atomic<u32>, 2>;

// Without the sign bit, floats order as their bits do, with NaN last.
fn magnitude(value: f32) -> u32 {
    return bitcast<u32>(value) & 0x7fffffffu;
}

// Updates one element. Returns the magnitudes of its gradient and of its new value.
fn advance(item: u32, adam: Item, at: u32) -> vec2<u32> {
    let gradient = gradients(item, at);
    let first = adam.beta1 * first_moments(item, at) + (1.0 - adam.beta1) * gradient;
    let second = adam.beta2 * second_moments(item, at) + (1.0 - adam.beta2) * (gradient * gradient);
    let value = values(item, at) - adam.step_size * first / (sqrt(second) * adam.second_moment_scale + adam.epsilon);
    set_new_first_moments(item, at, first);
    set_new_second_moments(item, at, second);
    set_new_values(item, at, value);
    return vec2<u32>(magnitude(gradient), magnitude(value));
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    if (local < 2u) {
        atomicStore(&own_largest[local], 0u);
    }
    workgroupBarrier();
    let flat = flat_group(group, groups);
    let item = item_of(flat);
    let adam = constants_of(item);
    let first = (flat - first_group(item)) * 256u * ELEMENTS + local;
    var found = vec2<u32>(0u);
    for (var step = 0u; step < ELEMENTS; step++) {
        let at = first + 256u * step;
        if (at < adam.len) {
            found = max(found, advance(item, adam, at));
        }
    }
    // An integer maximum does not depend on the order.
    atomicMax(&own_largest[0], found.x);
    atomicMax(&own_largest[1], found.y);
    workgroupBarrier();
    if (local < 2u) {
        atomicMax(&largest[adam.maxima + local], atomicLoad(&own_largest[local]));
    }
}

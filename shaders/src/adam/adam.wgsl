// One update of every element of a group: m ← β1·m + (1 − β1)·g, v ← β2·v + (1 − β2)·g², p ← p − step·m / (√v·scale + ε).

struct Adam {
    beta1: f32,
    beta2: f32,
    step_size: f32,
    second_moment_scale: f32,
    epsilon: f32,
}

@group(0) @binding(0) var<uniform> adam: Adam;
@group(0) @binding(1) var<storage, read> gradients: array<f32>;
@group(0) @binding(2) var<storage, read> values: array<f32>;
@group(0) @binding(3) var<storage, read> first_moments: array<f32>;
@group(0) @binding(4) var<storage, read> second_moments: array<f32>;
@group(0) @binding(5) var<storage, read_write> new_values: array<f32>;
@group(0) @binding(6) var<storage, read_write> new_first_moments: array<f32>;
@group(0) @binding(7) var<storage, read_write> new_second_moments: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_group(group, groups) * 256u + local;
    if (index >= arrayLength(&new_values)) {
        return;
    }
    let gradient = gradients[index];
    let first = adam.beta1 * first_moments[index] + (1.0 - adam.beta1) * gradient;
    let second = adam.beta2 * second_moments[index] + (1.0 - adam.beta2) * (gradient * gradient);
    new_first_moments[index] = first;
    new_second_moments[index] = second;
    new_values[index] = values[index] - adam.step_size * first / (sqrt(second) * adam.second_moment_scale + adam.epsilon);
}

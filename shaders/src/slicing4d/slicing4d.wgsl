// Every chosen Gaussian at the instant; the parameters are kept in the order of the choice for the backward pass.

@group(0) @binding(7) var<storage, read> row_of_item: array<u32>;
@group(0) @binding(8) var<storage, read_write> displacements: array<f32>;
@group(0) @binding(9) var<storage, read_write> velocities: array<f32>;
@group(0) @binding(10) var<storage, read_write> factors: array<f32>;
@group(0) @binding(11) var<storage, read_write> faded_logits: array<f32>;
@group(0) @binding(12) var<storage, read_write> kept: array<Gaussian>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let item = flat_group(group, groups) * 64u + local;
    if (item >= slicing.count) {
        return;
    }
    let gaussian = gaussian_of(row_of_item[item]);
    kept[item] = gaussian;
    let axes = axes_of(gaussian);
    let time_row = time_row_of(axes.lengths[3]);
    let cut = cut_of(axes, time_row);
    for (var axis = 0u; axis < 3u; axis++) {
        displacements[3u * item + axis] = gaussian.offset_time * cut.velocity[axis];
        velocities[3u * item + axis] = cut.velocity[axis];
        factors[9u * item + axis] = cut.factor.x[axis];
        factors[9u * item + 3u + axis] = cut.factor.y[axis];
        factors[9u * item + 6u + axis] = cut.factor.z[axis];
    }
    faded_logits[item] = faded(gaussian.opacity_logit, log_share(gaussian.offset_time, time_row.deviation)).logit;
}

// Slices every 4D Gaussian at the instant. An absent Gaussian gets zeros and a hidden opacity. One invocation per
// Gaussian.
#import geometry::algebra
#import gpu::elements_64
#import rasteriser::slicing4d::stored_gaussian
#import rasteriser::slicing4d::time_slice

@group(0) @binding(7) var<storage, read_write> displacements: array<f32>;
@group(0) @binding(8) var<storage, read_write> velocities: array<f32>;
@group(0) @binding(9) var<storage, read_write> factors: array<f32>;
@group(0) @binding(10) var<storage, read_write> faded_logits: array<f32>;
@group(0) @binding(11) var<storage, read_write> present: array<f32>;

fn write(row: u32, offset_time: f32, velocity: vec3<f32>, factor: Rows) {
    for (var axis = 0u; axis < 3u; axis++) {
        displacements[3u * row + axis] = offset_time * velocity[axis];
        velocities[3u * row + axis] = velocity[axis];
        factors[9u * row + axis] = factor.x[axis];
        factors[9u * row + 3u + axis] = factor.y[axis];
        factors[9u * row + 6u + axis] = factor.z[axis];
    }
}

fn run(row: u32) {
    if (row >= slicing.count) {
        return;
    }
    let gaussian = gaussian_of(row);
    let axes = axes_of(gaussian);
    let time_row = time_row_of(axes.lengths[3]);
    let exists = is_present(gaussian, time_row);
    present[row] = select(0.0, 1.0, exists);
    if (!exists) {
        let nothing = vec3<f32>(0.0);
        write(row, 0.0, nothing, Rows(nothing, nothing, nothing));
        faded_logits[row] = slicing.hidden_logit;
        return;
    }
    let cut = cut_of(axes, time_row);
    write(row, gaussian.offset_time, cut.velocity, cut.factor);
    faded_logits[row] = faded(gaussian.opacity_logit, log_share(gaussian.offset_time, time_row.deviation)).logit;
}

// Average pooling: the mean of every cell. LANES invocations per cell and channel.
#import gpu::flat_group
#import gpu::row_sum
#import networks::pooling::pooling_grid
#const LANES

@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read_write> grid: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_group(group, groups) * (256u / LANES) + local / LANES;
    let in_range = index < sizes.cells.x * sizes.cells.y * sizes.channels;
    var own = 0.0;
    if (in_range) {
        let at = index / sizes.channels;
        let cell = vec2<u32>(at / sizes.cells.y, at % sizes.cells.y);
        let range = pixels_of(cell);
        let extent = range.zw - range.xy;
        for (var step = local % LANES; step < extent.x * extent.y; step += LANES) {
            let pixel = range.xy + vec2<u32>(step / extent.y, step % extent.y);
            let value = image[(pixel.x * sizes.pixels.y + pixel.y) * sizes.channels + index % sizes.channels];
            own += share_of(cell, pixel) * value;
        }
    }
    let sum = row_sum(local, own);
    if (in_range && local % LANES == 0u) {
        grid[index] = sum;
    }
}

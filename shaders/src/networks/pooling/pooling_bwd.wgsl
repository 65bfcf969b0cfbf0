// The gradients of pixels, from those of the cells that they overlap. One invocation per pixel and channel.
#import gpu::elements
#import networks::pooling::pooling_grid

@group(0) @binding(1) var<storage, read> g_grid: array<f32>;
@group(0) @binding(2) var<storage, read_write> g_image: array<f32>;

fn run(index: u32) {
    if (index >= sizes.pixels.x * sizes.pixels.y * sizes.channels) {
        return;
    }
    let at = index / sizes.channels;
    let pixel = vec2<u32>(at / sizes.pixels.y, at % sizes.pixels.y);
    let range = cells_of(pixel);
    var sum = 0.0;
    for (var row = range.x; row < range.z; row++) {
        for (var column = range.y; column < range.w; column++) {
            let value = g_grid[(row * sizes.cells.y + column) * sizes.channels + index % sizes.channels];
            sum += share_of(vec2<u32>(row, column), pixel) * value;
        }
    }
    g_image[index] = sum;
}

// A grid of cells over an image: the same definitions as on the CPU. In units of 1/(pixels·cells) of an axis, a cell is
// `pixels` long and a pixel `cells` long, so that all borders are integers.

struct Pool {
    // Pixels and cells along the height and the width.
    pixels: vec2<u32>,
    cells: vec2<u32>,
    channels: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> sizes: Pool;

// The range of pixels that a cell overlaps: the first, then the end.
fn pixels_of(cell: vec2<u32>) -> vec4<u32> {
    return vec4<u32>(cell * sizes.pixels / sizes.cells, ((cell + 1u) * sizes.pixels + sizes.cells - 1u) / sizes.cells);
}

// The range of cells that overlap a pixel: the first, then the end.
fn cells_of(pixel: vec2<u32>) -> vec4<u32> {
    let end = ((pixel + 1u) * sizes.cells + sizes.pixels - 1u) / sizes.pixels;
    return vec4<u32>(pixel * sizes.cells / sizes.pixels, end);
}

// The fraction of a cell's area that a pixel covers.
fn share_of(cell: vec2<u32>, pixel: vec2<u32>) -> f32 {
    let start = max(cell * sizes.pixels, pixel * sizes.cells);
    let end = min((cell + 1u) * sizes.pixels, (pixel + 1u) * sizes.cells);
    let shares = vec2<f32>(end - start) / vec2<f32>(sizes.pixels);
    return shares.x * shares.y;
}

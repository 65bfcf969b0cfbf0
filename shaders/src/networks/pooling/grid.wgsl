// The grid of cells over an image: the same definitions as on the CPU. Along an axis, in units of 1/(pixels·cells) of it,
// cells are `pixels` and pixels `cells` long.

struct Pool {
    // Pixels and cells along the height and the width.
    pixels: vec2<u32>,
    cells: vec2<u32>,
    channels: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> sizes: Pool;

// The first and the end of the pixels that a cell touches.
fn pixels_of(cell: vec2<u32>) -> vec4<u32> {
    return vec4<u32>(cell * sizes.pixels / sizes.cells, ((cell + 1u) * sizes.pixels + sizes.cells - 1u) / sizes.cells);
}

// The first and the end of the cells that touch a pixel.
fn cells_of(pixel: vec2<u32>) -> vec4<u32> {
    return vec4<u32>(pixel * sizes.cells / sizes.pixels, ((pixel + 1u) * sizes.cells + sizes.pixels - 1u) / sizes.pixels);
}

// The share of a cell's area that a pixel covers.
fn share_of(cell: vec2<u32>, pixel: vec2<u32>) -> f32 {
    let start = max(cell * sizes.pixels, pixel * sizes.cells);
    let end = min((cell + 1u) * sizes.pixels, (pixel + 1u) * sizes.cells);
    let shares = vec2<f32>(end - start) / vec2<f32>(sizes.pixels);
    return shares.x * shares.y;
}


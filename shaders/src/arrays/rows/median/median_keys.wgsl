// Sort keys of non-negative elements: their bits, which sort as their values do. Elements without a flag sort last. One
// invocation per element.
#import gpu::elements
#import gpu::nowhere

struct Median {
    len: u32,
}

@group(0) @binding(0) var<uniform> sizes: Median;
@group(0) @binding(1) var<storage, read> x: array<u32>;
@group(0) @binding(2) var<storage, read> flags: array<f32>;
@group(0) @binding(3) var<storage, read_write> keys: array<u32>;

fn run(at: u32) {
    if (at < sizes.len) {
        // Clears the sign, which a zero or a NaN may have.
        keys[at] = select(NOWHERE, x[at] & 0x7fffffffu, flags[at] > 0.0);
    }
}

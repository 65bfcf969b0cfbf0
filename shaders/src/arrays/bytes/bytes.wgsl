// Colours as bytes, four to a word: clamped to [0, 1], rounded half up; NaN becomes 0. `others` becomes 1 if a value is
// infinite or NaN. One invocation per word.
#import gpu::elements
#import gpu::is_finite

struct Colors {
    len: u32,
}

@group(0) @binding(0) var<uniform> colors: Colors;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read_write> words: array<u32>;
@group(0) @binding(3) var<storage, read_write> others: array<atomic<u32>>;

fn run(word: u32) {
    var bytes = 0u;
    for (var place = 0u; place < 4u; place++) {
        let index = 4u * word + place;
        if (index < colors.len) {
            let value = x[index];
            if (!is_finite(value)) {
                atomicMax(&others[0], 1u);
            }
            if (!is_nan(value)) {
                bytes |= u32(clamp(value, 0.0, 1.0) * 255.0 + 0.5) << (8u * place);
            }
        }
    }
    if (4u * word < colors.len) {
        words[word] = bytes;
    }
}

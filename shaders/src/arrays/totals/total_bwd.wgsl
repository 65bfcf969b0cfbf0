// The gradient of a sum: the same value for every element. One invocation per element.
#import gpu::elements

struct Spread {
    factor: f32,
}

@group(0) @binding(0) var<uniform> spread: Spread;
@group(0) @binding(1) var<storage, read> dy: array<f32>;
@group(0) @binding(2) var<storage, read_write> dx: array<f32>;

fn run(index: u32) {
    if (index < arrayLength(&dx)) {
        dx[index] = spread.factor * dy[0];
    }
}

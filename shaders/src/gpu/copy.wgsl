// Copies an array: y = x. One invocation per element.
#import gpu::elements

struct Size {
    len: u32,
}

@group(0) @binding(0) var<uniform> size: Size;
@group(0) @binding(1) var<storage, read> x: array<u32>;
@group(0) @binding(2) var<storage, read_write> y: array<u32>;

fn run(index: u32) {
    if (index < size.len) {
        y[index] = x[index];
    }
}

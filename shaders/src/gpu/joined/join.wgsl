// Copies an array to its place in a joined one, and writes where that is. One invocation per element, at least one.
#import gpu::elements

struct Place {
    // The array's position among the joined ones.
    index: u32,
    first: u32,
    len: u32,
}

@group(0) @binding(0) var<uniform> place: Place;
@group(0) @binding(1) var<storage, read> x: array<u32>;
@group(0) @binding(2) var<storage, read_write> joined: array<u32>;

fn run(at: u32) {
    if (at == 0u) {
        joined[2u * place.index] = place.first;
        joined[2u * place.index + 1u] = place.len;
    }
    if (at < place.len) {
        joined[place.first + at] = x[at];
    }
}

// Index of the first occurrence of each key in a sorted list, by binary search. One invocation per key.
#import gpu::elements

struct Starts {
    len: u32,
}

@group(0) @binding(0) var<uniform> sizes: Starts;
@group(0) @binding(1) var<storage, read> sorted_keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> starts: array<u32>;

fn run(key: u32) {
    if (key >= arrayLength(&starts)) {
        return;
    }
    var low = 0u;
    var high = sizes.len;
    while (low < high) {
        let middle = (low + high) / 2u;
        if (sorted_keys[middle] < key) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    starts[key] = low;
}

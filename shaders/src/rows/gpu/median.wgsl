// The middle one of the sorted keys that stand for an element.

struct Median {
    len: u32,
}

@group(0) @binding(0) var<uniform> sizes: Median;
@group(0) @binding(1) var<storage, read> sorted: array<u32>;
@group(0) @binding(2) var<storage, read_write> median: array<u32>;

@compute @workgroup_size(1)
fn main() {
    // How many there are, by halving the list.
    var low = 0u;
    var high = sizes.len;
    while (low < high) {
        let middle = (low + high) / 2u;
        if (sorted[middle] < NOWHERE) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    // The bits of 0 where there is none.
    var found = 0u;
    if (low > 0u) {
        found = sorted[low / 2u];
    }
    median[0] = found;
}

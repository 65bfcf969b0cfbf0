// The median of the sorted keys that belong to an element. One invocation.
#import arrays::sort::present_count

struct Median {
    len: u32,
}

@group(0) @binding(0) var<uniform> sizes: Median;
@group(0) @binding(1) var<storage, read> sorted_keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> median: array<u32>;

@compute @workgroup_size(1)
fn main() {
    let low = present_count(sizes.len);
    // The bits of 0 if there is none.
    var found = 0u;
    if (low > 0u) {
        found = sorted_keys[low / 2u];
    }
    median[0] = found;
}

// Index of the first occurrence of each key in a sorted list, by binary search. One invocation per key.

struct Starts {
    len: u32,
}

@group(0) @binding(0) var<uniform> sizes: Starts;
@group(0) @binding(1) var<storage, read> sorted_keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> starts: array<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let key = flat_group(group, groups) * 256u + local;
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

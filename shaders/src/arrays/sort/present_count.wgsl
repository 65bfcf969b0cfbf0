// The number of keys before NOWHERE among the first `len` of `sorted_keys`, by binary search.
#import gpu::nowhere
#extern var<storage, read> sorted_keys: array<u32>

fn present_count(len: u32) -> u32 {
    var low = 0u;
    var high = len;
    while (low < high) {
        let middle = (low + high) / 2u;
        if (sorted_keys[middle] < NOWHERE) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

// Binary search for `key` among the kept keys of one query and head, which start at `chosen[first]` in ascending order.
// Returns NOWHERE if the query does not keep the key.
#import gpu::nowhere
#import networks::attention::top_k::top_k_sizes
#extern var<storage, read> chosen: array<u32>

fn place_of(first: u32, key: u32) -> u32 {
    var low = first;
    var high = first + sizes.kept;
    while (low < high) {
        let middle = (low + high) / 2u;
        if (chosen[middle] < key) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    if (low < first + sizes.kept && chosen[low] == key) {
        return low;
    }
    return NOWHERE;
}

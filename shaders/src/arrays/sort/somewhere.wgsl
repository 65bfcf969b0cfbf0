// How many of so many `sorted_keys`, an array that the kernel declares, come before NOWHERE, by halving the list.
fn somewhere_count(len: u32) -> u32 {
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

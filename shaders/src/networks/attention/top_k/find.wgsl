// Where in `chosen`, from `first` on, a query of a head keeps a key: the kept keys are in ascending order.
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


// Adds the parts of products. The last column of a part holds the sums of the rows of A. One invocation per element.

struct Item {
    rows: u32,
    // Columns of a part; the last one holds the sums.
    columns: u32,
    parts: u32,
    // Bit mask: whether the product and the sums are added to the outputs' current values.
    adds: u32,
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let flat = flat_group(group, groups);
    let item = item_of(flat);
    let own = constants_of(item);
    let element = (flat - first_group(item)) * 256u + local;
    let elements = own.rows * own.columns;
    if (element >= elements) {
        return;
    }
    // Four independent loads at a time hide latency.
    var sum = 0.0;
    let whole = own.parts / 4u * 4u;
    for (var part = 0u; part < whole; part += 4u) {
        let four = gather_parts(item, element + (part + vec4<u32>(0u, 1u, 2u, 3u)) * elements);
        sum = (((sum + four.x) + four.y) + four.z) + four.w;
    }
    for (var part = whole; part < own.parts; part++) {
        sum += parts(item, element + part * elements);
    }
    put(item, element, sum);
}

fn put(item: u32, element: u32, sum: f32) {
    let own = constants_of(item);
    let row = element / own.columns;
    let column = element % own.columns;
    if (column == own.columns - 1u) {
        set_sums(item, row, select(sum, sum + sums(item, row), (own.adds & 2u) != 0u));
    } else {
        let at = row * (own.columns - 1u) + column;
        set_product(item, at, select(sum, sum + product(item, at), (own.adds & 1u) != 0u));
    }
}

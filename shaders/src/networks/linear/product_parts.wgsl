// Adds the parts of products. The last column of a part holds the sums of the rows of A. One invocation per element.
#import gpu::grouped::elements
#import gpu::grouped::grouped
#extern fn gather_parts(item: u32, at: vec4<u32>) -> vec4<f32>
#extern fn parts(item: u32, at: u32) -> f32
#extern fn product(item: u32, at: u32) -> f32
#extern fn set_product(item: u32, at: u32, value: f32)
#extern fn sums(item: u32, at: u32) -> f32
#extern fn set_sums(item: u32, at: u32, value: f32)

struct Item {
    rows: u32,
    // Columns of a part; the last one holds the sums.
    columns: u32,
    parts: u32,
    // Bit mask: whether the product and the sums are added to the outputs' current values.
    adds: u32,
}

fn run(item: u32, element: u32) {
    let own = constants_of(item);
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

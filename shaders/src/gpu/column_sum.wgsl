// Sums over the 256 / COLUMNS invocations that share a column, COLUMNS a power of two of at most 256, in workgroups of 256
// whose neighbouring invocations are neighbouring columns: in a fixed order, by halving distances.

var<workgroup> column_parts: array<f32, 256>;

// The sum of `value` over the invocations of a column, for each of them; all invocations of the workgroup call it together.
fn column_sum(local: u32, value: f32) -> f32 {
    workgroupBarrier();
    column_parts[local] = value;
    workgroupBarrier();
    for (var distance = 128u; distance >= COLUMNS; distance /= 2u) {
        if (local < distance) {
            column_parts[local] += column_parts[local + distance];
        }
        workgroupBarrier();
    }
    return column_parts[local % COLUMNS];
}

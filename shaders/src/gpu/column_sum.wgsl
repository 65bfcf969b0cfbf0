// Tree reduction over the 256 / COLUMNS invocations of a workgroup that share a column, in a fixed order. COLUMNS is a
// power of two, at most 256. Neighbouring invocations hold neighbouring columns.
#const COLUMNS

var<workgroup> column_parts: array<f32, 256>;

// Returns the sum of `value` over the invocations of a column to each of them. Every invocation of the workgroup must
// call it, in uniform control flow.
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

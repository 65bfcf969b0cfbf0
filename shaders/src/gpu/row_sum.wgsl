// Tree reduction over the LANES neighbouring invocations that share a row, in workgroups of 256 and in a fixed order.
// LANES is a power of two, at most 256.
#const LANES

var<workgroup> row_parts: array<f32, 256>;

// Returns the sum of `value` over the invocations of a row to each of them. Every invocation of the workgroup must call
// it, in uniform control flow.
fn row_sum(local: u32, value: f32) -> f32 {
    workgroupBarrier();
    row_parts[local] = value;
    workgroupBarrier();
    for (var distance = LANES / 2u; distance > 0u; distance /= 2u) {
        if (local % LANES < distance) {
            row_parts[local] += row_parts[local + distance];
        }
        workgroupBarrier();
    }
    return row_parts[local - local % LANES];
}

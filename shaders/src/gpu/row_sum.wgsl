// Sums over the LANES neighbouring invocations that share a row, LANES a power of two of at most 256, in workgroups of 256:
// in a fixed order, by halving distances.

var<workgroup> row_parts: array<f32, 256>;

// The sum of `value` over the invocations of a row, for each of them; all invocations of the workgroup call it together.
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

// The cell of every point on each of the six planes of every scale. One invocation per scale and point.

@group(0) @binding(1) var<storage, read> positions: array<f32>;
// [6·scales, points].
@group(0) @binding(2) var<storage, read_write> cell_of_entry: array<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let flat = flat_group(group, groups);
    let scale = item_of(flat);
    let point = (flat - first_group(scale)) * 256u + local;
    if (point >= points()) {
        return;
    }
    var low: vec3<u32>;
    for (var axis = 0u; axis < 3u; axis++) {
        low[axis] = lookup(positions[3u * point + axis], texels(scale, axis)).low;
    }
    for (var plane = 0u; plane < 6u; plane++) {
        let width = width_axis(plane);
        let height = height_axis(plane);
        var cell = first_cell(scale, plane) + low[width];
        if (height < 3u) {
            cell += low[height] * cells(scale, width);
        }
        cell_of_entry[first_entry(scale) + plane * points() + point] = cell;
    }
}

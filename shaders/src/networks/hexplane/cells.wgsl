// The cell of every point on each of the six planes of every scale. One invocation per scale and point.
#import gpu::grouped::elements
#import networks::hexplane::field

@group(0) @binding(1) var<storage, read> positions: array<f32>;
// [6·scales, points].
@group(0) @binding(2) var<storage, read_write> cell_of_entry: array<u32>;

fn run(scale: u32, point: u32) {
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

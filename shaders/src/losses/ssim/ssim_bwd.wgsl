// The gradient of the mean of SSIM: every pixel gathers the derivatives of the windows that cover it. One workgroup per
// tile and channel.
#import gpu::flat_group
#import losses::ssim::ssim_tile

@group(0) @binding(1) var<storage, read> render: array<f32>;
@group(0) @binding(2) var<storage, read> reference: array<f32>;
@group(0) @binding(3) var<storage, read> derivatives: array<f32>;
@group(0) @binding(4) var<storage, read> dy: array<f32>;
@group(0) @binding(5) var<storage, read_write> dx: array<f32>;

var<workgroup> reached: array<f32, REACHED>;
var<workgroup> filtered: array<f32, FILTERED>;

// Returns the weighted sum of one kind of derivative around the invocation's pixel. Every invocation of the workgroup
// must call it, in uniform control flow.
fn gathered(kind: u32, tile: Tile, local: u32) -> f32 {
    workgroupBarrier();
    for (var place = local; place < REACHED; place += 256u) {
        let pixel = reached_pixel(tile, place);
        reached[place] = 0.0;
        if (pixel.x >= 0) {
            let plane = image.width * image.height * image.channels;
            reached[place] = derivatives[kind * plane + planar(tile, u32(pixel.x), u32(pixel.y))];
        }
    }
    workgroupBarrier();
    for (var at = local; at < FILTERED; at += 256u) {
        let first = at / TILE * REACH + at % TILE;
        var sum = 0.0;
        for (var tap = 0u; tap < TAPS; tap++) {
            sum += weight(tap) * reached[first + tap];
        }
        filtered[at] = sum;
    }
    workgroupBarrier();
    var sum = 0.0;
    for (var tap = 0u; tap < TAPS; tap++) {
        sum += weight(tap) * filtered[local + tap * TILE];
    }
    return sum;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let tile = tile_of(flat_group(group, groups));
    let d_x = gathered(0u, tile, local);
    let d_xx = gathered(1u, tile, local);
    let d_xy = gathered(2u, tile, local);
    let column = tile.first_column + local % TILE;
    let row = tile.first_row + local / TILE;
    if (tile.in_image && column < image.width && row < image.height) {
        let at = interleaved(tile, column, row);
        dx[at] = image.per_window * dy[0] * (d_x + 2.0 * d_xx * render[at] + d_xy * reference[at]);
    }
}

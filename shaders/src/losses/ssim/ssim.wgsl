// Sums SSIM over the windows that count, per tile. If KEEP is 1, also writes its derivatives with respect to the
// windowed means of x, x² and xy: three sets of planes, 0 for windows that do not count. One workgroup per tile and
// channel.
#import gpu::flat_group
#import gpu::row_sum
#import losses::ssim::ssim_tile
#const KEEP

@group(0) @binding(1) var<storage, read> render: array<f32>;
@group(0) @binding(2) var<storage, read> reference: array<f32>;
@group(0) @binding(3) var<storage, read_write> derivatives: array<f32>;
@group(0) @binding(4) var<storage, read_write> sums: array<f32>;

const C1: f32 = 0.0001;
const C2: f32 = 0.0009;

var<workgroup> reached_x: array<f32, REACHED>;
var<workgroup> reached_y: array<f32, REACHED>;
// x, y, x², y² or xy, one at a time, filtered along rows.
var<workgroup> filtered: array<f32, FILTERED>;

struct Similarity {
    value: f32,
    d_x: f32,
    d_xx: f32,
    d_xy: f32,
}

fn similarity(x: f32, y: f32, xx: f32, yy: f32, xy: f32) -> Similarity {
    let variance_x = xx - x * x;
    let variance_y = yy - y * y;
    let clamped = variance_x < 0.0 || variance_y < 0.0;
    let covariance = select(xy - x * y, 0.0, clamped);
    let a = x * x + y * y + C1;
    let b = select(variance_x, 0.0, variance_x < 0.0) + select(variance_y, 0.0, variance_y < 0.0) + C2;
    let c = 2.0 * x * y + C1;
    let d = 2.0 * covariance + C2;
    let inverse = 1.0 / (a * b);
    let value = c * d * inverse;
    let above_one = value > 1.0;
    let d_xx = select(-value * a * inverse, 0.0, variance_x < 0.0 || above_one);
    let d_xy = select(2.0 * c * inverse, 0.0, clamped || above_one);
    // The mean of x affects A and C directly, and B and D through the variance and the covariance.
    let direct = select(2.0 * (y * d * inverse - x * value * b * inverse), 0.0, above_one);
    return Similarity(select(value, 1.0, above_one), direct - 2.0 * x * d_xx - y * d_xy, d_xx, d_xy);
}

// One of the five products at a place of the reached area.
fn product(kind: u32, place: u32) -> f32 {
    let x = reached_x[place];
    let y = reached_y[place];
    switch kind {
        case 0u: { return x; }
        case 1u: { return y; }
        case 2u: { return x * x; }
        case 3u: { return y * y; }
        default: {}
    }
    return x * y;
}

// Returns the windowed mean of a product at the invocation's pixel. Every invocation of the workgroup must call it, in
// uniform control flow.
fn mean(kind: u32, local: u32) -> f32 {
    workgroupBarrier();
    for (var at = local; at < FILTERED; at += 256u) {
        let first = at / TILE * REACH + at % TILE;
        var sum = 0.0;
        for (var tap = 0u; tap < TAPS; tap++) {
            sum += weight(tap) * product(kind, first + tap);
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
    let number = flat_group(group, groups);
    let tile = tile_of(number);
    for (var place = local; place < REACHED; place += 256u) {
        let pixel = reached_pixel(tile, place);
        reached_x[place] = 0.0;
        reached_y[place] = 0.0;
        if (pixel.x >= 0) {
            let at = interleaved(tile, u32(pixel.x), u32(pixel.y));
            reached_x[place] = render[at];
            reached_y[place] = reference[at];
        }
    }
    let x = mean(0u, local);
    let y = mean(1u, local);
    let xx = mean(2u, local);
    let yy = mean(3u, local);
    let xy = mean(4u, local);

    let column = tile.first_column + local % TILE;
    let row = tile.first_row + local / TILE;
    let counts_column = column >= image.margin && column + image.margin < image.width;
    let counts_row = row >= image.margin && row + image.margin < image.height;
    var result = similarity(x, y, xx, yy, xy);
    if (!(counts_column && counts_row)) {
        result = Similarity(0.0, 0.0, 0.0, 0.0);
    }
    if (KEEP == 1u && tile.in_image && column < image.width && row < image.height) {
        let at = planar(tile, column, row);
        let plane = image.width * image.height * image.channels;
        derivatives[at] = result.d_x;
        derivatives[plane + at] = result.d_xx;
        derivatives[2u * plane + at] = result.d_xy;
    }
    let sum = row_sum(local, result.value);
    if (local == 0u && tile.in_image) {
        sums[number] = sum;
    }
}

// Backward blending without subgroup operations: the rows of a tile's entries. One workgroup per tile. In each round of
// a few entries, an invocation first acts as a pixel and stores its shares, then sums four columns of one entry over
// some of the pixels. Then the parts are added in order.
#import gpu::flat_group
#import rasteriser::blending::pixel_share
#import rasteriser::blending::splat_at_pixel
#import rasteriser::blending::staged_entries
#const BATCH

// Entries of a round.
const ROUND: u32 = 4u;
// Parts of the pixels, half a cell each.
const PARTS: u32 = 16u;
const PART_PIXELS: u32 = 16u;
// Columns at a time.
const COLUMNS: u32 = 16u;

// [entry of the round, pixel]; written if the entry intersects the pixel's cell.
var<workgroup> shares: array<vec2<f32>, ROUND * PIXELS>;
// [entry of the round, column, part].
var<workgroup> parts: array<f32, ROUND * COLUMNS * PARTS>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let tile = flat_group(group, groups);
    if (tile >= blend.tiles) {
        return;
    }
    let start = tile_starts[tile];
    let end = tile_starts[tile + 1u];
    if (end <= start) {
        return;
    }
    let corner = corner_of(tile);
    var pixel = pixel_before(pixel_of(corner, local));
    let blended_end = min(start + last_of_tile(local, pixel.last), end);

    clear_meetings(local);
    workgroupBarrier();
    var turn = 0u;
    var first = start;
    for (; first < blended_end; first += BATCH) {
        let count = min(end - first, BATCH);
        stage(local, turn, first, count, corner);
        workgroupBarrier();
        for (var round = 0u; round < count; round += ROUND) {
            leave_round(&pixel, meeting(turn, local / CELL_PIXELS, 0u), first - start, round, local);
            workgroupBarrier();
            for (var column = 0u; column < ROW; column += COLUMNS) {
                // The parts of the previous columns must have been read.
                if (column > 0u) {
                    workgroupBarrier();
                }
                add_part(local, turn, corner, round, column);
                workgroupBarrier();
                write_rows(local, first, count, round, column);
            }
        }
        turn = 1u - turn;
    }
    clear_rows(local, first, end);
}

// Advances a pixel past the entries of a round that intersect its cell.
fn leave_round(pixel: ptr<function, Pixel>, entries: u32, before: u32, round: u32, local: u32) {
    for (var k = 0u; k < ROUND; k++) {
        let entry = round + k;
        if ((entries >> entry & 1u) == 0u) {
            continue;
        }
        var share = Share(0.0, 0.0);
        let sigma = sigma_of(entry, offset_to(entry, (*pixel).center));
        if (before + entry < (*pixel).last && is_seen(entry, sigma)) {
            share = pass_entry(pixel, entry, sigma, true);
        }
        shares[k * PIXELS + local] = vec2<f32>(share.v, share.weight);
    }
}

// Sums four columns of one entry over the pixels of one part. Neighbouring invocations take the same columns.
fn add_part(local: u32, turn: u32, corner: vec2<u32>, round: u32, first_column: u32) {
    let four = local / (ROUND * PARTS);
    let k = local / PARTS % ROUND;
    let part = local % PARTS;
    let column = first_column + 4u * four;
    var sums = vec4<f32>(0.0);
    if (column < ROW && (meeting(turn, part * PART_PIXELS / CELL_PIXELS, 0u) >> (round + k) & 1u) != 0u) {
        for (var i = 0u; i < PART_PIXELS; i++) {
            let place = part * PART_PIXELS + i;
            let share = shares[k * PIXELS + place];
            sums += columns_of(Share(share.x, share.y), round + k, pixel_of(corner, place), column);
        }
    }
    for (var i = 0u; i < 4u; i++) {
        parts[(k * COLUMNS + 4u * four + i) * PARTS + part] = sums[i];
    }
}

// The values that a pixel's share adds to four columns of a row.
fn columns_of(share: Share, entry: u32, position: vec2<u32>, column: u32) -> vec4<f32> {
    let offset = offset_to(entry, center_of(position));
    if (column == 0u) {
        return share.v * vec4<f32>(1.0, offset.x, offset.x * offset.x, offset.x * offset.y);
    }
    if (!is_in_image(position)) {
        return vec4<f32>(0.0);
    }
    let at = position.y * blend.width + position.x;
    if (column == 4u) {
        let channels = share.weight * vec2<f32>(channel_gradient(at, 0u), channel_gradient(at, 1u));
        return vec4<f32>(share.v * vec2<f32>(offset.y, offset.y * offset.y), channels);
    }
    return share.weight * channel_gradients(at, column - MOMENTS);
}

// Writes columns of the rows of a round, one column of one entry per invocation: adds the parts in order.
fn write_rows(local: u32, first: u32, count: u32, round: u32, first_column: u32) {
    let k = local / COLUMNS;
    let column = first_column + local % COLUMNS;
    let entry = first + round + k;
    if (k >= ROUND || round + k >= count || column >= ROW) {
        return;
    }
    var sum = 0.0;
    for (var part = 0u; part < PARTS; part++) {
        sum += parts[local * PARTS + part];
    }
    rows[entry * ROW + column] = sum;
}

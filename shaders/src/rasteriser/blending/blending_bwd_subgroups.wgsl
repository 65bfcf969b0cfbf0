// Backward blending with subgroups of SUBGROUP invocations: the rows of a tile's entries. One workgroup per tile, one
// invocation per pixel. Shuffles sum the contributions of a subgroup's pixels; the sums of the subgroups are added in
// order.
#import gpu::flat_group
#import rasteriser::blending::pixel_share
#import rasteriser::blending::splat_at_pixel
#import rasteriser::blending::staged_entries
#import rasteriser::blending::subgroup_exchange
#import rasteriser::blending::subgroup_sum
#const BATCH, SUBGROUP

const SUBGROUPS: u32 = PIXELS / SUBGROUP;
// Number of invocations that hold the same one of eight sums, and of four sums.
const EIGHTH: u32 = (SUBGROUP + 7u) / 8u;
const QUARTER: u32 = SUBGROUP / 4u;

// [entry, subgroup, column]; valid for the entries in the subgroup's bit mask in `left`.
var<workgroup> parts: array<f32, BATCH * SUBGROUPS * ROW>;
var<workgroup> left: array<u32, SUBGROUPS>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(subgroup_invocation_id) lane: u32,
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
    var pixel = pixel_before(pixel_of(corner, subgroup * SUBGROUP + lane));
    let blended_end = min(start + last_of_tile(local, pixel.last), end);
    let last_of_subgroup = subgroupMax(pixel.last);

    clear_meetings(local);
    workgroupBarrier();
    var turn = 0u;
    var first = start;
    for (; first < blended_end; first += BATCH) {
        let count = min(end - first, BATCH);
        stage(local, turn, first, count, corner);
        workgroupBarrier();
        let entries = meeting_subgroup(turn, subgroup) & first_bits(last_of_subgroup - min(first - start, last_of_subgroup));
        let given = leave_batch(&pixel, entries, first - start, subgroup, lane);
        if (lane == 0u) {
            left[subgroup] = given;
        }
        workgroupBarrier();
        write_rows(local, first, count);
        turn = 1u - turn;
    }
    clear_rows(local, first, end);
}

fn first_bits(count: u32) -> u32 {
    return select((1u << (count & 31u)) - 1u, 0xffffffffu, count >= 32u);
}

// Bit mask of the entries of the batch that intersect a cell of the subgroup's pixels.
fn meeting_subgroup(turn: u32, subgroup: u32) -> u32 {
    var entries = 0u;
    for (var cell = subgroup * SUBGROUP / CELL_PIXELS; cell * CELL_PIXELS < (subgroup + 1u) * SUBGROUP; cell++) {
        entries |= meeting(turn, cell, 0u);
    }
    return entries;
}

// Advances the pixels of a subgroup past the entries, a mask that all of them share. Returns the mask of the entries
// that any of them blended.
fn leave_batch(pixel: ptr<function, Pixel>, entries: u32, before: u32, subgroup: u32, lane: u32) -> u32 {
    var given = 0u;
    for (var rest = entries; rest != 0u; rest &= rest - 1u) {
        let entry = firstTrailingBit(rest);
        let offset = offset_to(entry, (*pixel).center);
        let sigma = sigma_of(entry, offset);
        let is_blended = before + entry < (*pixel).last && is_seen(entry, sigma);
        if (!subgroupAny(is_blended)) {
            continue;
        }
        let share = pass_entry(pixel, entry, sigma, is_blended);
        leave(row_of(pixel, share, offset), (entry * SUBGROUPS + subgroup) * ROW, lane);
        given |= 1u << entry;
    }
    return given;
}

// Sums the rows of a subgroup's pixels into `parts`, from `at` on.
fn leave(row: Row, at: u32, lane: u32) {
    if (SUBGROUP >= 8u) {
        let sum = added8(lane, row.first, row.second);
        if (lane % EIGHTH == 0u) {
            parts[at + lane / EIGHTH] = sum;
        }
    } else {
        parts[at + lane] = added4(lane, row.first, 2u);
        parts[at + 4u + lane] = added4(lane, row.second, 2u);
    }
    leave_tail(row.tails[0], at, 8u, lane);
    for (var tail = 1u; tail < TAILS; tail++) {
        leave_tail(row.tails[tail], at, 8u + 4u * tail, lane);
    }
}

fn leave_tail(values: vec4<f32>, at: u32, first_column: u32, lane: u32) {
    let sum = added4(lane, values, SUBGROUP / 2u);
    let column = first_column + lane / QUARTER;
    if (lane % QUARTER == 0u && column < ROW) {
        parts[at + column] = sum;
    }
}

// Writes the rows of a batch, one column of one entry per invocation at a time: adds the subgroups' sums in order.
fn write_rows(local: u32, first: u32, count: u32) {
    for (var at = local; at < count * ROW; at += PIXELS) {
        let entry = at / ROW;
        let column = at % ROW;
        var sum = 0.0;
        for (var subgroup = 0u; subgroup < SUBGROUPS; subgroup++) {
            if ((left[subgroup] >> entry & 1u) != 0u) {
                sum += parts[(entry * SUBGROUPS + subgroup) * ROW + column];
            }
        }
        rows[(first + entry) * ROW + column] = sum;
    }
}

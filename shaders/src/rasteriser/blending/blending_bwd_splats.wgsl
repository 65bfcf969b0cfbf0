// Backward blending with one invocation per entry (Mallick et al. 2024, Taming 3DGS): the rows of a tile's entries. A
// workgroup is one tile and one subgroup of SUBGROUP invocations. A bucket of SUBGROUP consecutive entries stays in
// place while the tile's pixels stream past it: in each step a pixel moves to the next invocation, which adds the
// pixel's contribution to its own row. Between buckets the pixels are in workgroup memory. Each pixel visits each entry
// once.
#import gpu::flat_group
#import gpu::nowhere
#import rasteriser::blending::pixel_share
#import rasteriser::blending::splat_at_pixel
#import rasteriser::blending::tile_cells
#const EXTRAS, SUBGROUP

// The entry of an invocation: a batch of one.
var<private> places: array<vec4<f32>, 1>;
var<private> shapes: array<vec4<f32>, 1>;
var<private> colors: array<vec4<f32>, 1>;
var<private> own_extras: array<f32, EXTRAS + 1u>;

// Gradients per pixel, padded so that `Held` has an odd number of words: neighbouring invocations then read from
// different banks of workgroup memory.
const HELD: u32 = CHANNELS + CHANNELS % 2u;

// The state of a pixel between two buckets, as scalars.
struct Held {
    transmittance: f32,
    remaining: f32,
    center_x: f32,
    center_y: f32,
    last: u32,
    gradients: array<f32, HELD>,
}

// In the order of places: cell by cell.
var<workgroup> held: array<Held, PIXELS>;
// The maximum of the last entries of a cell's pixels.
var<workgroup> cell_lasts: array<atomic<u32>, CELLS>;

fn extra_value(entry: u32, extra: u32) -> f32 {
    if (extra < EXTRAS) {
        return own_extras[extra];
    }
    return 0.0;
}

@compute @workgroup_size(SUBGROUP)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
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
    let blended_end = min(start + hold_pixels(lane, corner), end);
    for (var first = start; first < blended_end; first += SUBGROUP) {
        let count = min(blended_end - first, SUBGROUP);
        let cells = subgroupOr(hold_entry(lane, first, count, corner)) & cells_reaching(first - start);
        let row = stream(cells, first - start, count, lane);
        if (lane < count) {
            write_row(row, (first + lane) * ROW);
        }
        // The next bucket reads the pixels' state after this one.
        workgroupBarrier();
    }
    clear_rows(lane, SUBGROUP, blended_end, end);
}

// Loads the tile's pixels into workgroup memory. Returns the maximum of their last entries.
fn hold_pixels(lane: u32, corner: vec2<u32>) -> u32 {
    for (var cell = lane; cell < CELLS; cell += SUBGROUP) {
        atomicStore(&cell_lasts[cell], 0u);
    }
    workgroupBarrier();
    var last = 0u;
    for (var place = lane; place < PIXELS; place += SUBGROUP) {
        let pixel = pixel_before(pixel_of(corner, place));
        held[place].transmittance = pixel.transmittance;
        held[place].remaining = pixel.remaining;
        held[place].center_x = pixel.center.x;
        held[place].center_y = pixel.center.y;
        held[place].last = pixel.last;
        held[place].gradients[0] = pixel.head.x;
        held[place].gradients[1] = pixel.head.y;
        for (var channel = 2u; channel < CHANNELS; channel++) {
            held[place].gradients[channel] = pixel.tails[(channel - 2u) / 4u][(channel - 2u) % 4u];
        }
        atomicMax(&cell_lasts[place / CELL_PIXELS], pixel.last);
        last = max(last, pixel.last);
    }
    return last_of_tile(lane, last);
}

// Loads the invocation's entry of a bucket. Returns a bit mask of the cells that it intersects.
fn hold_entry(lane: u32, first: u32, count: u32, corner: vec2<u32>) -> u32 {
    if (lane >= count) {
        return 0u;
    }
    let rank = ranks[first + lane];
    places[0] = records[3u * rank];
    shapes[0] = records[3u * rank + 1u];
    colors[0] = records[3u * rank + 2u];
    for (var extra = 0u; extra < EXTRAS; extra++) {
        own_extras[extra] = extras[rank * EXTRAS + extra];
    }
    return cells_meeting(places[0], shapes[0], corner);
}

// Bit mask of the cells with a pixel whose last blended entry is at index `before` or later.
fn cells_reaching(before: u32) -> u32 {
    var cells = 0u;
    for (var cell = 0u; cell < CELLS; cell++) {
        cells |= u32(atomicLoad(&cell_lasts[cell]) > before) << cell;
    }
    return cells;
}

// Converts a bit mask of cells to a list of cell numbers, four bits each.
fn listed(cells: u32) -> u32 {
    var list = 0u;
    var shift = 0u;
    for (var rest = cells; rest != 0u; rest &= rest - 1u) {
        list |= firstTrailingBit(rest) << shift;
        shift += 4u;
    }
    return list;
}

// Streams the pixels of the cells past a bucket that starts at entry `before`. Returns the row of the invocation's
// entry.
fn stream(cells: u32, before: u32, count: u32, lane: u32) -> Row {
    var row: Row;
    let list = listed(cells);
    let pixels = CELL_PIXELS * countOneBits(cells);
    let steps = select(0u, pixels + count - 1u, pixels > 0u);
    // An entry past the end fails every pixel's `last` test.
    let own = select(NOWHERE, before + lane, lane < count);
    var state = vec2<f32>(0.0);
    for (var step = 0u; step < steps; step++) {
        // Not the index of a pixel before the first one arrives, where it wraps around, and after the last.
        let at = step - lane;
        let place = (list >> (at / CELL_PIXELS * 4u & 31u) & 7u) * CELL_PIXELS + at % CELL_PIXELS;
        state = subgroupShuffleUp(state, 1u);
        if (lane == 0u) {
            state = vec2<f32>(held[place].transmittance, held[place].remaining);
        }
        var pixel = pixel_at(place, state);
        let offset = offset_to(0u, pixel.center);
        let sigma = sigma_of(0u, offset);
        let is_blended = at < pixels && own < pixel.last && is_seen(0u, sigma);
        if (subgroupAny(is_blended)) {
            let share = pass_entry(&pixel, 0u, sigma, is_blended);
            add(&row, row_of(&pixel, share, offset));
            state = vec2<f32>(pixel.transmittance, pixel.remaining);
        }
        if (lane == SUBGROUP - 1u && at < pixels) {
            held[place].transmittance = state.x;
            held[place].remaining = state.y;
        }
    }
    return row;
}

// The pixel at a place, with (transmittance, remaining) from `state`.
fn pixel_at(place: u32, state: vec2<f32>) -> Pixel {
    var pixel: Pixel;
    pixel.center = vec2<f32>(held[place].center_x, held[place].center_y);
    pixel.last = held[place].last;
    pixel.transmittance = state.x;
    pixel.remaining = state.y;
    pixel.head = vec2<f32>(held[place].gradients[0], held[place].gradients[1]);
    for (var tail = 0u; tail < TAILS; tail++) {
        let channel = 2u + 4u * tail;
        pixel.tails[tail] = vec4<f32>(
            held_gradient(place, channel),
            held_gradient(place, channel + 1u),
            held_gradient(place, channel + 2u),
            held_gradient(place, channel + 3u),
        );
    }
    return pixel;
}

fn held_gradient(place: u32, channel: u32) -> f32 {
    if (channel < CHANNELS) {
        return held[place].gradients[channel];
    }
    return 0.0;
}

fn add(sum: ptr<function, Row>, row: Row) {
    (*sum).first += row.first;
    (*sum).second += row.second;
    for (var tail = 0u; tail < TAILS; tail++) {
        (*sum).tails[tail] += row.tails[tail];
    }
}

fn write_row(row: Row, at: u32) {
    var columns = row;
    for (var column = 0u; column < ROW; column++) {
        if (column < 4u) {
            rows[at + column] = columns.first[column];
        } else if (column < 8u) {
            rows[at + column] = columns.second[column - 4u];
        } else {
            rows[at + column] = columns.tails[(column - 8u) / 4u][column % 4u];
        }
    }
}

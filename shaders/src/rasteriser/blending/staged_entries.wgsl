// Stages the entries of a tile in workgroup memory, one batch at a time, with bit masks of the entries that intersect
// each cell. BATCH is at most the number of invocations.
#import rasteriser::blending::splat_at_pixel
#import rasteriser::blending::tile_cells
#const BATCH, EXTRAS

// Words of 32 entries.
const WORDS: u32 = (BATCH + 31u) / 32u;
// Words of the bit masks of a batch.
const MEETINGS: u32 = CELLS * WORDS;

// Mean, A, k; m, opacity, cutoff; colour.
var<workgroup> places: array<vec4<f32>, BATCH>;
var<workgroup> shapes: array<vec4<f32>, BATCH>;
var<workgroup> colors: array<vec4<f32>, BATCH>;
var<workgroup> staged_ranks: array<u32, BATCH>;
// [turn, cell, word]: double-buffered, so that one batch's masks are cleared while the other's are in use.
var<workgroup> meetings: array<atomic<u32>, 2u * MEETINGS>;

// One word of the bit mask of the entries of the current batch that intersect a cell.
fn meeting(turn: u32, cell: u32, word: u32) -> u32 {
    return atomicLoad(&meetings[turn * MEETINGS + cell * WORDS + word]);
}

// An extra channel of an entry of the batch; 0 past the last channel.
fn extra_value(entry: u32, extra: u32) -> f32 {
    if (extra < EXTRAS) {
        return extras[staged_ranks[entry] * EXTRAS + extra];
    }
    return 0.0;
}

// Call once before the first batch, followed by a barrier.
fn clear_meetings(local: u32) {
    for (var at = local; at < 2u * MEETINGS; at += PIXELS) {
        atomicStore(&meetings[at], 0u);
    }
}

// Loads the entries first..first + count. There must be a barrier between the last use of the previous batch and this
// call, and between this call and the first use of the batch.
fn stage(local: u32, turn: u32, first: u32, count: u32, corner: vec2<u32>) {
    if (local < MEETINGS) {
        atomicStore(&meetings[(1u - turn) * MEETINGS + local], 0u);
    }
    if (local >= count) {
        return;
    }
    let rank = ranks[first + local];
    let place = records[3u * rank];
    let shape = records[3u * rank + 1u];
    places[local] = place;
    shapes[local] = shape;
    colors[local] = records[3u * rank + 2u];
    staged_ranks[local] = rank;
    let cells = cells_meeting(place, shape, corner);
    // The result does not depend on the order in which bits are set.
    for (var cell = 0u; cell < CELLS; cell++) {
        if ((cells >> cell & 1u) != 0u) {
            atomicOr(&meetings[turn * MEETINGS + cell * WORDS + local / 32u], 1u << (local % 32u));
        }
    }
}

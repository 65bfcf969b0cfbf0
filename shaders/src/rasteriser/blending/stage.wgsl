// The entries of a tile, a batch at a time, in workgroup memory, and which of them meet which cell of the tile. BATCH is at
// most the number of invocations.

// Words of 32 entries.
const WORDS: u32 = (BATCH + 31u) / 32u;
// Bits of a batch.
const MEETINGS: u32 = CELLS * WORDS;

// Mean, A, k; m, opacity, cutoff; colour.
var<workgroup> places: array<vec4<f32>, BATCH>;
var<workgroup> shapes: array<vec4<f32>, BATCH>;
var<workgroup> colors: array<vec4<f32>, BATCH>;
var<workgroup> staged_ranks: array<u32, BATCH>;
// [turn, cell, word]: two batches take turns, so that one is cleared while the other is used.
var<workgroup> meetings: array<atomic<u32>, 2u * MEETINGS>;

// The entries of the current batch that meet a cell, by bits of a word.
fn meeting(turn: u32, cell: u32, word: u32) -> u32 {
    return atomicLoad(&meetings[turn * MEETINGS + cell * WORDS + word]);
}

// A channel of an entry of the batch; none behind the last.
fn extra_value(entry: u32, extra: u32) -> f32 {
    if (extra < EXTRAS) {
        return extras[staged_ranks[entry] * EXTRAS + extra];
    }
    return 0.0;
}

// Before the first batch, followed by a barrier.
fn clear_meetings(local: u32) {
    for (var at = local; at < 2u * MEETINGS; at += PIXELS) {
        atomicStore(&meetings[at], 0u);
    }
}

// Fetches the entries first..first + count. A barrier must lie between the last use of the batch before and this, and
// between this and the first use of the batch.
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
    // Setting bits in any order gives the same word.
    for (var cell = 0u; cell < CELLS; cell++) {
        if ((cells >> cell & 1u) != 0u) {
            atomicOr(&meetings[turn * MEETINGS + cell * WORDS + local / 32u], 1u << (local % 32u));
        }
    }
}

// Matrix products A·B in tiles of 64×64. Each of the 256 invocations of a workgroup computes 4×4 elements of a tile.
//
// A_BY_TERM and B_BY_TERM are 1 if the terms of a sum are adjacent in memory. The other constants switch options on
// with 1. BIAS: the bias is added. RELU: negative results become 0. MASK: an element of A counts as 0 if the element of
// `side` at its index is not positive. SUMS: the sums of the rows of A are a further column of the output. TOGETHER:
// the products of all items add up to one output; the items differ in their number of terms only. The importing file
// defines `result` and `set_result` for the outputs and the indices of the operands, `a_at(item, row, term)` and
// `b_at(item, term, column)`, which are NOWHERE for elements that count as 0.
//
// If A_BY_TERM and SUMS are 2, the item decides: in A, rows are adjacent for items with sums, terms for the others.
#import gpu::flat_group
#import gpu::grouped::grouped
#import gpu::nowhere
#const A_BY_TERM, BIAS, B_BY_TERM, ITEMS, MASK, RELU, SUMS, TOGETHER
#extern fn gather_a(item: u32, at: vec4<u32>) -> vec4<f32>
#extern fn gather_b(item: u32, at: vec4<u32>) -> vec4<f32>
#extern fn gather_side(item: u32, at: vec4<u32>) -> vec4<f32>
#extern fn side(item: u32, at: u32) -> f32
#extern fn a_at(item: u32, row: u32, term: u32) -> u32
#extern fn b_at(item: u32, term: u32, column: u32) -> u32
#extern fn result(item: u32, at: u32) -> f32
#extern fn set_result(item: u32, at: u32, value: f32)

struct Item {
    // Rows and columns of A·B, and the number of terms of each sum.
    rows: u32,
    columns: u32,
    terms: u32,
    // Sums are split into parts of this many terms, each with its own A·B.
    terms_per_part: u32,
    row_tiles: u32,
    column_tiles: u32,
    // Strides in elements along each dimension of A and B.
    a_row: u32,
    a_term: u32,
    b_term: u32,
    b_column: u32,
    // Row stride of the output, [parts, rows, …].
    y_row: u32,
    // Whether the result is added to the output's current values.
    adds: u32,
    // Whether the sums of the rows of A are computed, if the item decides.
    has_sums: u32,
}

const TILE: u32 = 64u;
const STEP: u32 = 16u;
// One more than a tile's width: invocations that write neighbouring terms then use different banks of workgroup memory.
const STRIDE: u32 = 65u;
const FOUR: vec4<u32> = vec4<u32>(0u, 1u, 2u, 3u);

// [term, row] and [term, column].
var<workgroup> a_tile: array<f32, 1040>;
var<workgroup> b_tile: array<f32, 1040>;

fn makes_sums(item: u32) -> bool {
    return SUMS == 1u || (SUMS == 2u && constants_of(item).has_sums == 1u);
}

fn a_is_by_term(item: u32) -> bool {
    return A_BY_TERM == 1u || (A_BY_TERM == 2u && !makes_sums(item));
}

// Four elements of A; 0 out of range and for terms from `end` on.
fn load_a(item: u32, rows: vec4<u32>, terms: vec4<u32>, end: u32) -> vec4<f32> {
    var at = vec4<u32>(NOWHERE);
    for (var four = 0u; four < 4u; four++) {
        if (rows[four] < constants_of(item).rows && terms[four] < end) {
            at[four] = a_at(item, rows[four], terms[four]);
        }
    }
    var counts = at != vec4<u32>(NOWHERE);
    let safe = select(vec4<u32>(), at, counts);
    let values = gather_a(item, safe);
    if (MASK == 1u) {
        // Written so that NaN counts as positive.
        counts = counts & !(gather_side(item, safe) <= vec4<f32>());
    }
    return select(vec4<f32>(), values, counts);
}

fn load_b(item: u32, terms: vec4<u32>, columns: vec4<u32>, end: u32) -> vec4<f32> {
    var at = vec4<u32>(NOWHERE);
    for (var four = 0u; four < 4u; four++) {
        if (columns[four] < constants_of(item).columns && terms[four] < end) {
            at[four] = b_at(item, terms[four], columns[four]);
        }
    }
    let counts = at != vec4<u32>(NOWHERE);
    return select(vec4<f32>(), gather_b(item, select(vec4<u32>(), at, counts)), counts);
}

// Loads four elements of each tile per invocation; neighbouring invocations read neighbouring elements.
fn load_tiles(item: u32, local: u32, first_row: u32, first_column: u32, first_term: u32, end: u32) {
    var rows = vec4<u32>(local % TILE);
    var terms = local / TILE + 4u * FOUR;
    if (a_is_by_term(item)) {
        rows = local / STEP + 16u * FOUR;
        terms = vec4<u32>(local % STEP);
    }
    let of_a = load_a(item, first_row + rows, first_term + terms, end);
    for (var four = 0u; four < 4u; four++) {
        a_tile[terms[four] * STRIDE + rows[four]] = of_a[four];
    }
    var columns = vec4<u32>(local % TILE);
    terms = local / TILE + 4u * FOUR;
    if (B_BY_TERM == 1u) {
        columns = local / STEP + 16u * FOUR;
        terms = vec4<u32>(local % STEP);
    }
    let of_b = load_b(item, first_term + terms, first_column + columns, end);
    for (var four = 0u; four < 4u; four++) {
        b_tile[terms[four] * STRIDE + columns[four]] = of_b[four];
    }
}

fn put(item: u32, at: u32, value: f32) {
    if (constants_of(item).adds == 1u) {
        set_result(item, at, result(item, at) + value);
    } else {
        set_result(item, at, value);
    }
}

fn write_row(item: u32, part: u32, row: u32, first_column: u32, values: vec4<f32>) {
    let own = constants_of(item);
    if (row >= own.rows) {
        return;
    }
    for (var four = 0u; four < 4u; four++) {
        let column = first_column + 16u * four;
        if (column < own.columns) {
            var value = values[four];
            if (BIAS == 1u) {
                value += side(item, column);
            }
            if (RELU == 1u && value < 0.0) {
                value = 0.0;
            }
            put(item, (part * own.rows + row) * own.y_row + column, value);
        }
    }
}

// The range of items whose products a workgroup of an item adds.
fn items_of(item: u32) -> vec2<u32> {
    if (TOGETHER == 1u) {
        return vec2<u32>(0u, ITEMS);
    }
    return vec2<u32>(item, item + 1u);
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let flat = flat_group(group, groups);
    var item = item_of(flat);
    if (TOGETHER == 1u) {
        item = 0u;
    }
    let own = constants_of(item);
    let tile = flat - first_group(item);
    let column_tile = tile % own.column_tiles;
    let row_tile = tile / own.column_tiles % own.row_tiles;
    let part = tile / (own.column_tiles * own.row_tiles);
    let first_row = row_tile * TILE;
    let first_column = column_tile * TILE;
    let first_term = part * own.terms_per_part;

    // This invocation has the rows y, y + 16, … and the columns x, x + 16, … of the tile.
    let x = local % 16u;
    let y_row = local / 16u;
    var row_0 = vec4<f32>();
    var row_1 = vec4<f32>();
    var row_2 = vec4<f32>();
    var row_3 = vec4<f32>();
    var row_sums = vec4<f32>();
    let has_sums = makes_sums(item);
    let items = items_of(item);
    for (var of_item = items.x; of_item < items.y; of_item++) {
        let end = min(first_term + constants_of(of_item).terms_per_part, constants_of(of_item).terms);
        for (var step = first_term; step < end; step += STEP) {
            load_tiles(of_item, local, first_row, first_column, step, end);
            workgroupBarrier();
            for (var term = 0u; term < STEP; term++) {
                let at = term * STRIDE;
                let of_a = at + y_row;
                let of_b = at + x;
                let rows = vec4<f32>(a_tile[of_a], a_tile[of_a + 16u], a_tile[of_a + 32u], a_tile[of_a + 48u]);
                let columns = vec4<f32>(b_tile[of_b], b_tile[of_b + 16u], b_tile[of_b + 32u], b_tile[of_b + 48u]);
                row_0 += rows.x * columns;
                row_1 += rows.y * columns;
                row_2 += rows.z * columns;
                row_3 += rows.w * columns;
                if (has_sums) {
                    row_sums += rows;
                }
            }
            workgroupBarrier();
        }
    }

    // A folded dispatch may have workgroups past the last part.
    if (first_term < own.terms || part == 0u) {
        write_row(item, part, first_row + y_row, first_column + x, row_0);
        write_row(item, part, first_row + y_row + 16u, first_column + x, row_1);
        write_row(item, part, first_row + y_row + 32u, first_column + x, row_2);
        write_row(item, part, first_row + y_row + 48u, first_column + x, row_3);
        if (has_sums && column_tile == 0u && x == 0u) {
            for (var four = 0u; four < 4u; four++) {
                let row = first_row + y_row + 16u * four;
                if (row < own.rows) {
                    put(item, (part * own.rows + row) * own.y_row + own.columns, row_sums[four]);
                }
            }
        }
    }
}

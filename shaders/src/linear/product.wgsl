// A matrix product A·B by tiles of 64×64, of which each of the 256 invocations of a workgroup has 4×4 elements.
//
// A_BY_TERM and B_BY_TERM are 1 where the terms of a sum are neighbours in memory. BIAS: the bias is added, and where RELU
// is 1, what is negative becomes 0. SUMS: the sums of the rows of A are written, too. What follows this
// text loads the operands: `load_a(row, term, end)` and `load_b(term, column, end)`, zero beyond the sizes and from `end` on.

struct Product {
    // Of A·B, and the terms of each sum.
    rows: u32,
    columns: u32,
    terms: u32,
    // The sums are made in parts, each with its own A·B.
    terms_per_part: u32,
    row_tiles: u32,
    column_tiles: u32,
    // Elements between neighbours along each dimension of A and B.
    a_row: u32,
    a_term: u32,
    b_term: u32,
    b_column: u32,
}

@group(0) @binding(0) var<uniform> product: Product;
@group(0) @binding(1) var<storage, read> a: array<f32>;
@group(0) @binding(2) var<storage, read> b: array<f32>;
// Whose element at the place of an element of A tells whether that counts.
@group(0) @binding(3) var<storage, read> output: array<f32>;
@group(0) @binding(4) var<storage, read> bias: array<f32>;
// [parts, rows, columns].
@group(0) @binding(5) var<storage, read_write> y: array<f32>;
// [parts, rows].
@group(0) @binding(6) var<storage, read_write> sums: array<f32>;

const TILE: u32 = 64u;
const STEP: u32 = 16u;
// One more than a tile's elements: invocations that write neighbouring terms then use different banks of memory.
const STRIDE: u32 = 65u;

// [term, row] and [term, column].
var<workgroup> a_tile: array<f32, 1040>;
var<workgroup> b_tile: array<f32, 1040>;

// Four elements of each tile per invocation; neighbours read neighbours.
fn load_tiles(local: u32, first_row: u32, first_column: u32, first_term: u32, end: u32) {
    for (var item = 0u; item < 4u; item++) {
        var a_at = vec2<u32>(local % TILE, local / TILE + 4u * item);
        if (A_BY_TERM == 1u) {
            a_at = vec2<u32>(local / STEP + 16u * item, local % STEP);
        }
        a_tile[a_at.y * STRIDE + a_at.x] = load_a(first_row + a_at.x, first_term + a_at.y, end);
        var b_at = vec2<u32>(local % TILE, local / TILE + 4u * item);
        if (B_BY_TERM == 1u) {
            b_at = vec2<u32>(local / STEP + 16u * item, local % STEP);
        }
        b_tile[b_at.y * STRIDE + b_at.x] = load_b(first_term + b_at.y, first_column + b_at.x, end);
    }
}

fn write_row(part: u32, row: u32, first_column: u32, values: vec4<f32>) {
    if (row >= product.rows) {
        return;
    }
    for (var item = 0u; item < 4u; item++) {
        let column = first_column + 16u * item;
        if (column < product.columns) {
            var value = values[item];
            if (BIAS == 1u) {
                value += bias[column];
            }
            if (RELU == 1u && value < 0.0) {
                value = 0.0;
            }
            y[(part * product.rows + row) * product.columns + column] = value;
        }
    }
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let tile = flat_group(group, groups);
    let column_tile = tile % product.column_tiles;
    let row_tile = tile / product.column_tiles % product.row_tiles;
    let part = tile / (product.column_tiles * product.row_tiles);
    let first_row = row_tile * TILE;
    let first_column = column_tile * TILE;
    let first_term = part * product.terms_per_part;
    let end = min(first_term + product.terms_per_part, product.terms);

    // The rows y, y + 16, … and the columns x, x + 16, … of the tile.
    let x = local % 16u;
    let y_row = local / 16u;
    var row_0 = vec4<f32>();
    var row_1 = vec4<f32>();
    var row_2 = vec4<f32>();
    var row_3 = vec4<f32>();
    var row_sums = vec4<f32>();
    for (var step = first_term; step < end; step += STEP) {
        load_tiles(local, first_row, first_column, step, end);
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
            if (SUMS == 1u) {
                row_sums += rows;
            }
        }
        workgroupBarrier();
    }

    // A dispatch that was folded has workgroups beyond the last part.
    if (first_term < product.terms || part == 0u) {
        write_row(part, first_row + y_row, first_column + x, row_0);
        write_row(part, first_row + y_row + 16u, first_column + x, row_1);
        write_row(part, first_row + y_row + 32u, first_column + x, row_2);
        write_row(part, first_row + y_row + 48u, first_column + x, row_3);
        if (SUMS == 1u && column_tile == 0u && x == 0u) {
            for (var item = 0u; item < 4u; item++) {
                let row = first_row + y_row + 16u * item;
                if (row < product.rows) {
                    sums[part * product.rows + row] = row_sums[item];
                }
            }
        }
    }
}

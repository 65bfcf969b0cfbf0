// The operands of a layer, by their strides. Where MASK is 1, an element of A counts as 0 where the output is not positive.

fn load_a(row: u32, term: u32, end: u32) -> f32 {
    if (row >= product.rows || term >= end) {
        return 0.0;
    }
    let at = row * product.a_row + term * product.a_term;
    if (MASK == 1u && output[at] <= 0.0) {
        return 0.0;
    }
    return a[at];
}

fn load_b(term: u32, column: u32, end: u32) -> f32 {
    if (column >= product.columns || term >= end) {
        return 0.0;
    }
    return b[term * product.b_term + column * product.b_column];
}

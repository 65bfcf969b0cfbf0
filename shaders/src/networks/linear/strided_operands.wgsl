// The operands of a linear layer, addressed by strides.
#import gpu::grouped::grouped
#import networks::linear::product

fn a_at(item: u32, row: u32, term: u32) -> u32 {
    let own = constants_of(item);
    return row * own.a_row + term * own.a_term;
}

fn b_at(item: u32, term: u32, column: u32) -> u32 {
    let own = constants_of(item);
    return term * own.b_term + column * own.b_column;
}

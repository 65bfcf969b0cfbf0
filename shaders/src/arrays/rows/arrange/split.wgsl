// Copies every part's columns of joined rows back; the part's other columns become 0. One invocation per element of a part.
#import arrays::rows::arrange::joined_part
#import gpu::grouped::elements
#import gpu::grouped::grouped
#extern fn set_part(item: u32, at: u32, value: f32)

@group(0) @binding(1) var<storage, read> joined: array<f32>;

fn run(item: u32, at: u32) {
    let own = constants_of(item);
    if (at >= own.rows * own.columns) {
        return;
    }
    let row = at / own.columns;
    let column = at % own.columns;
    var value = 0.0;
    if (column < own.width) {
        value = joined[row * own.joined_columns + own.first + column];
    }
    set_part(item, at, value);
}

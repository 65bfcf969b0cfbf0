// Copies the leading columns of every part to their place in joined rows. One invocation per copied element.
#import arrays::rows::arrange::joined_part
#import gpu::grouped::elements
#import gpu::grouped::grouped
#extern fn part(item: u32, at: u32) -> f32

@group(0) @binding(1) var<storage, read_write> joined: array<f32>;

fn run(item: u32, at: u32) {
    let own = constants_of(item);
    if (at >= own.rows * own.width) {
        return;
    }
    let row = at / own.width;
    let column = at % own.width;
    joined[row * own.joined_columns + own.first + column] = part(item, row * own.columns + column);
}

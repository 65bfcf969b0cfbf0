// A convolution as a matrix product. DIRECTION 0: patches of x times weights. DIRECTION 1: patches of
// dy (the output pixels whose taps read an input pixel) times weights. DIRECTION 2: dy transposed times patches of x.
#import gpu::grouped::grouped
#import gpu::nowhere
#import networks::linear::product
#import networks::linear::separate_outputs
#const CHANNELS, DILATION, DIRECTION, INPUT_HEIGHT, INPUT_WIDTH, KERNEL_WIDTH, OUTPUTS, OUTPUT_HEIGHT, OUTPUT_WIDTH
#const PADDING, PIXEL_STRIDE, TAPS

// The input pixel that a tap of an output pixel reads, or NOWHERE in the padding.
fn source_of(pixel: u32, tap: u32) -> u32 {
    let row = pixel / OUTPUT_WIDTH * PIXEL_STRIDE + tap / KERNEL_WIDTH * DILATION;
    let column = pixel % OUTPUT_WIDTH * PIXEL_STRIDE + tap % KERNEL_WIDTH * DILATION;
    if (row < PADDING || column < PADDING || row >= INPUT_HEIGHT + PADDING || column >= INPUT_WIDTH + PADDING) {
        return NOWHERE;
    }
    return (row - PADDING) * INPUT_WIDTH + column - PADDING;
}

// The output pixel whose tap reads an input pixel, or NOWHERE: the inverse of `source_of`.
fn reader_of(pixel: u32, tap: u32) -> u32 {
    let row = pixel / INPUT_WIDTH + PADDING;
    let column = pixel % INPUT_WIDTH + PADDING;
    let tap_row = tap / KERNEL_WIDTH * DILATION;
    let tap_column = tap % KERNEL_WIDTH * DILATION;
    if (row < tap_row || column < tap_column) {
        return NOWHERE;
    }
    let from_row = row - tap_row;
    let from_column = column - tap_column;
    let on_grid = from_row % PIXEL_STRIDE == 0u && from_column % PIXEL_STRIDE == 0u;
    let at = vec2<u32>(from_row, from_column) / PIXEL_STRIDE;
    if (!on_grid || at.x >= OUTPUT_HEIGHT || at.y >= OUTPUT_WIDTH) {
        return NOWHERE;
    }
    return at.x * OUTPUT_WIDTH + at.y;
}

fn a_at(item: u32, row: u32, term: u32) -> u32 {
    if (DIRECTION == 2u) {
        return term * OUTPUTS + row;
    }
    var depth = CHANNELS;
    if (DIRECTION == 1u) {
        depth = OUTPUTS;
    }
    var pixel = 0u;
    if (DIRECTION == 0u) {
        pixel = source_of(row, term / depth);
    } else {
        pixel = reader_of(row, term / depth);
    }
    if (pixel == NOWHERE) {
        return NOWHERE;
    }
    return pixel * depth + term % depth;
}

fn b_at(item: u32, term: u32, column: u32) -> u32 {
    if (DIRECTION == 0u) {
        return column * constants_of(item).terms + term;
    }
    if (DIRECTION == 1u) {
        return (term % OUTPUTS * TAPS + term / OUTPUTS) * CHANNELS + column;
    }
    let pixel = source_of(term, column / CHANNELS);
    if (pixel == NOWHERE) {
        return NOWHERE;
    }
    return pixel * CHANNELS + column % CHANNELS;
}

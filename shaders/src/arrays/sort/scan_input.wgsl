// Prefix sums of the numbers of an array.
#import arrays::sort::scan

@group(0) @binding(3) var<storage, read> input: array<u32>;

fn number(index: u32) -> u32 {
    return input[index];
}

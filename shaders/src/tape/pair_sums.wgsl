// y = a + b for every pair of tensors. One invocation per element.
#import gpu::grouped::elements
#import gpu::grouped::grouped
#extern fn a(item: u32, at: u32) -> f32
#extern fn b(item: u32, at: u32) -> f32
#extern fn set_y(item: u32, at: u32, value: f32)

struct Item {
    len: u32,
}

fn run(item: u32, at: u32) {
    if (at < constants_of(item).len) {
        set_y(item, at, a(item, at) + b(item, at));
    }
}

// Matrix products with one output each.
#extern fn y(item: u32, at: u32) -> f32
#extern fn set_y(item: u32, at: u32, value: f32)

fn result(item: u32, at: u32) -> f32 {
    return y(item, at);
}

fn set_result(item: u32, at: u32, value: f32) {
    set_y(item, at, value);
}

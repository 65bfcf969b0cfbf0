// The second difference of a plane along its height, at the element `first` and the two below it.
#extern fn values(item: u32, at: u32) -> f32

fn second_difference(item: u32, first: u32, row_len: u32) -> f32 {
    let center = values(item, first + row_len);
    return values(item, first) - center - center + values(item, first + 2u * row_len);
}

// Squared second differences along the height.

fn second_difference(item: u32, first: u32) -> f32 {
    let row_len = constants_of(item).row_len;
    let center = values(item, first + row_len);
    return values(item, first) - center - center + values(item, first + 2u * row_len);
}

fn term(item: u32, at: u32) -> f32 {
    let difference = second_difference(item, at);
    return difference * difference;
}

// An element is the first, the middle and the last of three second differences, where those are there.
fn derivative(item: u32, at: u32) -> f32 {
    let plane = constants_of(item);
    let row = at / plane.row_len;
    var sum = 0.0;
    if (row + 2u < plane.rows) {
        sum += second_difference(item, at);
    }
    if (row >= 1u && row + 1u < plane.rows) {
        sum -= 2.0 * second_difference(item, at - plane.row_len);
    }
    if (row >= 2u) {
        sum += second_difference(item, at - 2u * plane.row_len);
    }
    return 2.0 * sum;
}

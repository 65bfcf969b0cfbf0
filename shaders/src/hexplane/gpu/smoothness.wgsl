// Squared second differences along the height.

fn second_difference(first: u32) -> f32 {
    let center = values[first + plane.row_len];
    return values[first] - center - center + values[first + 2u * plane.row_len];
}

fn term(at: u32) -> f32 {
    let difference = second_difference(at);
    return difference * difference;
}

// An element is the first, the middle and the last of three second differences, where those are there.
fn derivative(at: u32) -> f32 {
    let row = at / plane.row_len;
    var sum = 0.0;
    if (row + 2u < plane.rows) {
        sum += second_difference(at);
    }
    if (row >= 1u && row + 1u < plane.rows) {
        sum -= 2.0 * second_difference(at - plane.row_len);
    }
    if (row >= 2u) {
        sum += second_difference(at - 2u * plane.row_len);
    }
    return 2.0 * sum;
}

// The gradient of every element of every plane, through all means that it contributes to. One invocation per element.
#import gpu::grouped::elements
#import gpu::grouped::grouped
#import networks::hexplane::plane_means::second_difference
#extern fn values(item: u32, at: u32) -> f32
#extern fn dy_difference(item: u32, at: u32) -> f32
#extern fn dy_distance(item: u32, at: u32) -> f32
#extern fn gradient(item: u32, at: u32) -> f32
#extern fn set_gradient(item: u32, at: u32, value: f32)

struct Item {
    rows: u32,
    row_len: u32,
    // 1 over the number of second differences, and of distances to one; 0 if the mean is not needed.
    difference_factor: f32,
    distance_factor: f32,
    // Whether the gradient is added to the current values.
    adds: u32,
}

// An element is the first, the middle and the last term of up to three second differences.
fn difference_derivative(item: u32, at: u32, rows: u32, row_len: u32) -> f32 {
    let row = at / row_len;
    var sum = 0.0;
    if (row + 2u < rows) {
        sum += second_difference(item, at, row_len);
    }
    if (row >= 1u && row + 1u < rows) {
        sum -= 2.0 * second_difference(item, at - row_len, row_len);
    }
    if (row >= 2u) {
        sum += second_difference(item, at - 2u * row_len, row_len);
    }
    return 2.0 * sum;
}

fn distance_derivative(item: u32, at: u32) -> f32 {
    let value = values(item, at);
    return select(0.0, 1.0, value > 1.0) - select(0.0, 1.0, value < 1.0);
}

fn run(item: u32, at: u32) {
    let plane = constants_of(item);
    if (at >= plane.rows * plane.row_len) {
        return;
    }
    var sum = 0.0;
    if (plane.adds == 1u) {
        sum = gradient(item, at);
    }
    if (plane.distance_factor > 0.0) {
        sum += plane.distance_factor * dy_distance(item, 0u) * distance_derivative(item, at);
    }
    if (plane.difference_factor > 0.0) {
        let derivative = difference_derivative(item, at, plane.rows, plane.row_len);
        sum += plane.difference_factor * dy_difference(item, 0u) * derivative;
    }
    set_gradient(item, at, sum);
}

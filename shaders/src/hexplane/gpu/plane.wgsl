// A plane whose elements enter a mean.

struct Item {
    rows: u32,
    row_len: u32,
    // Terms of the mean, and 1 over their number (0 where there are none).
    terms: u32,
    factor: f32,
    // Where this plane's sums begin.
    first_sum: u32,
    // Whether its gradient adds to what is there.
    adds: u32,
}


// q / |q| of every row.

fn value(row: u32, column: u32) -> f32 {
    let unit = normalised(quaternion_0(row)).quaternion;
    return unit[column];
}

// q / |q| of every row.
#import geometry::algebra
#import geometry::quaternion::quaternion_rows

fn value(row: u32, column: u32) -> f32 {
    let unit = normalised(quaternion_0(row)).quaternion;
    return unit[column];
}

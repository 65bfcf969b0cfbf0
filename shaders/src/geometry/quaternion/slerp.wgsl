// Spherical linear interpolation of the quaternions of every row.

fn value(row: u32, column: u32) -> f32 {
    let unit = between(arc_of(row)).quaternion;
    return unit[column];
}

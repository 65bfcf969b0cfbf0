// Spherical linear interpolation of the quaternions of every row.
#import geometry::quaternion::slerp_arc

fn value(row: u32, column: u32) -> f32 {
    let unit = between(arc_of(row)).quaternion;
    return unit[column];
}

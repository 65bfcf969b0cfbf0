// Tests of the bits, because compilers may assume that no value is infinite or NaN, and functions such as `exp` may turn NaN into a
// number.

// Whether a value is neither infinite nor NaN.
fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

fn is_nan(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7fffffffu) > 0x7f800000u;
}

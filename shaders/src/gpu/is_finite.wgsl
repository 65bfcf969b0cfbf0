// Whether a value is neither infinite nor NaN: tests the bits, because compilers may assume that no value is NaN.
fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

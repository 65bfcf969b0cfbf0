// Exchanges values between invocations whose indices in the subgroup differ in one bit.

fn exchanged(value: f32, distance: u32) -> f32 {
    return subgroupShuffleXor(value, distance);
}

fn exchanged2(value: vec2<f32>, distance: u32) -> vec2<f32> {
    return subgroupShuffleXor(value, distance);
}

fn exchanged4(value: vec4<f32>, distance: u32) -> vec4<f32> {
    return subgroupShuffleXor(value, distance);
}

// Several sums at once over the SUBGROUP invocations of a subgroup. In each step an invocation keeps half of its
// partial sums and passes the other half to the invocation whose index differs in one bit. The order of additions
// depends on SUBGROUP alone.
#const SUBGROUP
#extern fn exchanged(value: f32, distance: u32) -> f32
#extern fn exchanged2(value: vec2<f32>, distance: u32) -> vec2<f32>
#extern fn exchanged4(value: vec4<f32>, distance: u32) -> vec4<f32>

// Returns one of four sums, selected by two bits of `lane`: that of `distance` and the next lower one. The sum is over
// all invocations whose indices differ in these bits and lower ones.
fn added4(lane: u32, values: vec4<f32>, distance: u32) -> f32 {
    let is_upper = (lane & distance) != 0u;
    let given2 = select(values.zw, values.xy, is_upper);
    let pair = select(values.xy, values.zw, is_upper) + exchanged2(given2, distance);
    let is_odd = (lane & (distance / 2u)) != 0u;
    let given = select(pair.y, pair.x, is_odd);
    var sum = select(pair.x, pair.y, is_odd) + exchanged(given, distance / 2u);
    // One sum remains, in parts. Unrolled, because it has at most five steps of known distance.
    if (distance >= 4u) {
        sum += exchanged(sum, distance / 4u);
    }
    if (distance >= 8u) {
        sum += exchanged(sum, distance / 8u);
    }
    if (distance >= 16u) {
        sum += exchanged(sum, distance / 16u);
    }
    if (distance >= 32u) {
        sum += exchanged(sum, distance / 32u);
    }
    if (distance >= 64u) {
        sum += exchanged(sum, distance / 64u);
    }
    return sum;
}

// Returns the sum with index lane / (SUBGROUP / 8) of eight; SUBGROUP is at least eight.
fn added8(lane: u32, first: vec4<f32>, second: vec4<f32>) -> f32 {
    let distance = SUBGROUP / 2u;
    let is_upper = (lane & distance) != 0u;
    let given4 = select(second, first, is_upper);
    return added4(lane, select(first, second, is_upper) + exchanged4(given4, distance), distance / 2u);
}

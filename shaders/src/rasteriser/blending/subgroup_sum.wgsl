// Sums over the SUBGROUP invocations of a subgroup, several at once: in each step an invocation keeps half of its sums and
// gives the others to the invocation whose number differs in one bit. What is added to what depends on SUBGROUP alone.

// Of four sums the one whose number is in the two bits of `lane` from `distance` downwards, of all invocations that differ
// in these bits and lower ones.
fn added4(lane: u32, values: vec4<f32>, distance: u32) -> f32 {
    let is_upper = (lane & distance) != 0u;
    let given2 = select(values.zw, values.xy, is_upper);
    let pair = select(values.xy, values.zw, is_upper) + exchanged2(given2, distance);
    let is_odd = (lane & (distance / 2u)) != 0u;
    let given = select(pair.y, pair.x, is_odd);
    var sum = select(pair.x, pair.y, is_odd) + exchanged(given, distance / 2u);
    // One sum is left, of which the invocations have parts; no loop, as it has at most five steps of known length.
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

// Of eight sums the one with the number lane / (SUBGROUP / 8); SUBGROUP is at least eight.
fn added8(lane: u32, first: vec4<f32>, second: vec4<f32>) -> f32 {
    let distance = SUBGROUP / 2u;
    let is_upper = (lane & distance) != 0u;
    let given4 = select(second, first, is_upper);
    return added4(lane, select(first, second, is_upper) + exchanged4(given4, distance), distance / 2u);
}

// The arc between two quaternions, for spherical linear interpolation.
#import geometry::algebra
#import geometry::quaternion::quaternion_rows
#import gpu::sine
#extern var<storage, read> x1: array<f32>
#extern var<storage, read> x2: array<f32>

// Above this cosine of the angle between the quaternions, the chord replaces the arc.
const CHORD_ABOVE: f32 = 0.9995;

// Both ends as unit quaternions, with b on the side of a.
struct Arc {
    a: Unit,
    b: Unit,
    sign: f32,
    cosine: f32,
    // The weights of both ends, and their derivatives with respect to the cosine and to t.
    weights: vec2<f32>,
    by_cosine: vec2<f32>,
    by_t: vec2<f32>,
}

// The inverse cosine of values in [0, 1]; WGSL's built-in function may be off by 7e-5. The polynomial of the inverse
// sine up to ½ is that of Cephes (Moshier 1989).
fn angle_of(cosine: f32) -> f32 {
    let is_near = cosine > 0.5;
    let x = select(cosine, sqrt(0.5 * (1.0 - cosine)), is_near);
    let z = x * x;
    var series = 4.2163199048e-2 * z + 2.4181311049e-2;
    series = (series * z + 4.5470025998e-2) * z + 7.4953002686e-2;
    let inverse_sine = x + x * z * (series * z + 1.6666752422e-1);
    return select(1.5707963267948966 - inverse_sine, 2.0 * inverse_sine, is_near);
}

fn arc_of(row: u32) -> Arc {
    var arc: Arc;
    arc.a = normalised(quaternion_0(row));
    arc.b = normalised(vec4<f32>(x1[4u * row], x1[4u * row + 1u], x1[4u * row + 2u], x1[4u * row + 3u]));
    let cosine = dot(arc.a.quaternion, arc.b.quaternion);
    arc.sign = select(1.0, -1.0, cosine < 0.0);
    arc.b.quaternion *= arc.sign;
    arc.cosine = arc.sign * cosine;
    let shares = vec2<f32>(1.0 - x2[row], x2[row]);
    arc.weights = shares;
    arc.by_cosine = vec2<f32>(0.0, 0.0);
    arc.by_t = vec2<f32>(-1.0, 1.0);
    if (!(arc.cosine > CHORD_ABOVE)) {
        // sin(sθ)/sin θ and its derivative by θ, divided by dcos θ/dθ = −sin θ.
        let angle = angle_of(arc.cosine);
        let sine = sqrt((1.0 - arc.cosine) * (1.0 + arc.cosine));
        let to_a = sine_and_cosine(shares.x * angle);
        let to_b = sine_and_cosine(shares.y * angle);
        let cosines = vec2<f32>(to_a.y, to_b.y);
        arc.weights = vec2<f32>(to_a.x, to_b.x) / sine;
        arc.by_cosine = (arc.weights * arc.cosine - shares * cosines) / (sine * sine);
        arc.by_t = vec2<f32>(-1.0, 1.0) * angle * cosines / sine;
    }
    return arc;
}

fn between(arc: Arc) -> Unit {
    return normalised(arc.weights.x * arc.a.quaternion + arc.weights.y * arc.b.quaternion);
}

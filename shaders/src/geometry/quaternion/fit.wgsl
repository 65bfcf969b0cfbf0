// The rotation that best maps the vectors of an owner to their later values (least squares): the leading eigenvector of
// Horn's matrix, by cyclic Jacobi rotations. One invocation per owner.
#import gpu::elements_64

struct Fit {
    owners: u32,
    per_owner: u32,
}

@group(0) @binding(0) var<uniform> fit: Fit;
@group(0) @binding(1) var<storage, read> before: array<f32>;
@group(0) @binding(2) var<storage, read> after: array<f32>;
@group(0) @binding(3) var<storage, read_write> rotations: array<vec4<f32>>;

const SWEEPS: u32 = 6u;
// Off-diagonal elements smaller than this, relative to the diagonal, count as zero: they are below the rounding of f32.
const NEGLIGIBLE: f32 = 1e-9;

alias Matrix = array<array<f32, 4>, 4>;

// The sum of outer products of a vector and its later value, by rows.
struct Correlation {
    x: vec3<f32>,
    y: vec3<f32>,
    z: vec3<f32>,
}

fn correlation_of(owner: u32) -> Correlation {
    var sum: Correlation;
    for (var vector = owner * fit.per_owner; vector < (owner + 1u) * fit.per_owner; vector++) {
        let at = 3u * vector;
        let edge = vec3<f32>(before[at], before[at + 1u], before[at + 2u]);
        let later = vec3<f32>(after[at], after[at + 1u], after[at + 2u]);
        sum.x += vec3<f32>(edge.x * later.x, edge.x * later.y, edge.x * later.z);
        sum.y += edge.y * later;
        sum.z += edge.z * later;
    }
    return sum;
}

fn horn(s: Correlation) -> Matrix {
    let wx = s.y.z - s.z.y;
    let wy = s.z.x - s.x.z;
    let wz = s.x.y - s.y.x;
    let xy = s.x.y + s.y.x;
    let xz = s.z.x + s.x.z;
    let yz = s.y.z + s.z.y;
    return Matrix(
        array<f32, 4>(s.x.x + s.y.y + s.z.z, wx, wy, wz),
        array<f32, 4>(wx, s.x.x - s.y.y - s.z.z, xy, xz),
        array<f32, 4>(wy, xy, s.y.y - s.x.x - s.z.z, yz),
        array<f32, 4>(wz, xz, yz, s.z.z - s.x.x - s.y.y),
    );
}

fn run(owner: u32) {
    if (owner >= fit.owners) {
        return;
    }
    var a = horn(correlation_of(owner));
    var vectors = Matrix(
        array<f32, 4>(1.0, 0.0, 0.0, 0.0),
        array<f32, 4>(0.0, 1.0, 0.0, 0.0),
        array<f32, 4>(0.0, 0.0, 1.0, 0.0),
        array<f32, 4>(0.0, 0.0, 0.0, 1.0),
    );
    for (var sweep = 0u; sweep < SWEEPS; sweep++) {
        for (var p = 0u; p < 3u; p++) {
            for (var q = p + 1u; q < 4u; q++) {
                if (abs(a[p][q]) <= NEGLIGIBLE * (abs(a[p][p]) + abs(a[q][q]))) {
                    continue;
                }
                let ratio = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let tangent = select(-1.0, 1.0, ratio >= 0.0) / (abs(ratio) + sqrt(ratio * ratio + 1.0));
                let cosine = 1.0 / sqrt(tangent * tangent + 1.0);
                for (var row = 0u; row < 4u; row++) {
                    let x = a[row][p];
                    let y = a[row][q];
                    a[row][p] = cosine * (x - tangent * y);
                    a[row][q] = cosine * (tangent * x + y);
                    let u = vectors[row][p];
                    let v = vectors[row][q];
                    vectors[row][p] = cosine * (u - tangent * v);
                    vectors[row][q] = cosine * (tangent * u + v);
                }
                for (var column = 0u; column < 4u; column++) {
                    let x = a[p][column];
                    let y = a[q][column];
                    a[p][column] = cosine * (x - tangent * y);
                    a[q][column] = cosine * (tangent * x + y);
                }
            }
        }
    }
    var largest = 0u;
    for (var at = 1u; at < 4u; at++) {
        if (a[at][at] > a[largest][largest]) {
            largest = at;
        }
    }
    let best = vec4<f32>(vectors[0][largest], vectors[1][largest], vectors[2][largest], vectors[3][largest]);
    for (var vector = owner * fit.per_owner; vector < (owner + 1u) * fit.per_owner; vector++) {
        rotations[vector] = best;
    }
}

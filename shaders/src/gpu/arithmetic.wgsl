// Measures arithmetic throughput: four chains of fused multiply-adds, each STEPS long and with values that stay finite.
// The chains depend only on themselves. One invocation per vector.
#import gpu::elements
#const STEPS

struct Constants { count: u32 }

@group(0) @binding(0) var<uniform> constants: Constants;
@group(0) @binding(1) var<storage, read> source: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> result: array<vec4<f32>>;

fn run(i: u32) {
    if (i < constants.count) {
        let factor = source[i];
        var a = factor;
        var b = factor.yzwx;
        var c = factor.zwxy;
        var d = factor.wxyz;
        for (var step = 0u; step < STEPS; step++) {
            a = fma(a, factor, b);
            b = fma(b, factor, c);
            c = fma(c, factor, d);
            d = fma(d, factor, a);
        }
        result[i] = a + b + c + d;
    }
}

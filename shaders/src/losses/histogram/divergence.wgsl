// The divergence of a histogram's shares from the uniform distribution, or its gradient if BACKWARD is 1. One
// workgroup.
#import gpu::row_sum
#const BACKWARD

struct Divergence {
    bins: u32,
}

@group(0) @binding(0) var<uniform> sizes: Divergence;
@group(0) @binding(1) var<storage, read> shares: array<f32>;
@group(0) @binding(2) var<storage, read> dy: array<f32>;
@group(0) @binding(3) var<storage, read_write> out: array<f32>;

// Added to a share before the logarithm, which is finite then.
const EMPTY_BIN: f32 = 1e-8;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    var own = 0.0;
    for (var bin = local; bin < sizes.bins; bin += 256u) {
        let share = shares[bin];
        let logarithm = log((share + EMPTY_BIN) * f32(sizes.bins));
        if (BACKWARD == 1u) {
            out[bin] = dy[0] * (logarithm + share / (share + EMPTY_BIN));
        } else {
            own += share * logarithm;
        }
    }
    let sum = row_sum(local, own);
    if (BACKWARD == 0u && local == 0u) {
        out[0] = sum;
    }
}

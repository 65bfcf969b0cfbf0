// Adds the sum of all previous blocks to the exclusive prefix sums within blocks. One invocation per number.
#import gpu::elements

struct Scan {
    len: u32,
}

@group(0) @binding(0) var<uniform> scan: Scan;
@group(0) @binding(1) var<storage, read> before: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;

const CAP: u32 = 0x20000000u;

fn run(index: u32) {
    if (index < scan.len) {
        sums[index] = min(sums[index] + before[index / 1024u], CAP);
    }
}

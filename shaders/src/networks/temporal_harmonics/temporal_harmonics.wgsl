// The sum of a row's waves at one time. One invocation per value.
#import gpu::elements
#import gpu::sine
#import networks::temporal_harmonics::wave_phase

@group(0) @binding(1) var<storage, read> waves: array<f32>;
@group(0) @binding(2) var<storage, read> times: array<f32>;
@group(0) @binding(3) var<storage, read_write> y: array<f32>;

fn run(at: u32) {
    if (at >= sizes.rows * sizes.used) {
        return;
    }
    let row = at / sizes.used;
    let offset = sizes.time - times[row];
    var sum = 0.0;
    for (var wave = 0u; wave < sizes.waves; wave++) {
        sum += sine_and_cosine(phase_of(wave, offset)).y * waves[(row * sizes.waves + wave) * sizes.stored + at % sizes.used];
    }
    y[at] = sum;
}

// Window attention: the weighted mean of the values. One invocation per query and head.
#import gpu::elements_64
#import networks::attention::window::window_weights
#const WINDOW
#extern fn hold_for(index: u32, invocations: u32)
#extern fn weight_at(at: u32) -> f32

@group(0) @binding(4) var<storage, read_write> y: array<f32>;

fn run(index: u32) {
    if (index >= sizes.rows * sizes.queries * sizes.heads) {
        return;
    }
    let head = index % sizes.heads;
    let token = index / sizes.heads % sizes.queries;
    let row = index / sizes.heads / sizes.queries;
    hold_for(index, sizes.rows * sizes.queries * sizes.heads);
    hold_weights(row, token, head);
    let out = query_channel(row, token, head);
    for (var channel = 0u; channel < sizes.channels / sizes.heads; channel++) {
        var sum = 0.0;
        for (var at = 0u; at < WINDOW; at++) {
            sum += weight_at(at) * values[window_channel(row, at, head) + channel];
        }
        y[out + channel] = sum;
    }
}

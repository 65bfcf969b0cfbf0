// Attention probability of every query and key, averaged over the heads. One invocation per query and key.
#import gpu::elements
#import gpu::nowhere
#import networks::attention::top_k::kept_key_search
#import networks::attention::top_k::top_k_sizes

@group(0) @binding(1) var<storage, read> chosen: array<u32>;
@group(0) @binding(2) var<storage, read> probabilities: array<f32>;
@group(0) @binding(3) var<storage, read_write> mean: array<f32>;

fn run(index: u32) {
    if (index >= sizes.queries * sizes.keys) {
        return;
    }
    var sum = 0.0;
    for (var head = 0u; head < sizes.heads; head++) {
        let place = place_of(kept_of(index / sizes.keys, head), index % sizes.keys);
        if (place != NOWHERE) {
            sum += probabilities[place];
        }
    }
    mean[index] = sum / f32(sizes.heads);
}

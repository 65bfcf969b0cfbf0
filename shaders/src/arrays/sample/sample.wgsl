// The row of every place and whether it was drawn, from the rows sorted by key. One invocation per place.
#import arrays::sort::present_count
#import gpu::elements

struct Sample {
    rows: u32,
    // The maximum number of drawn rows.
    places: u32,
    // The fraction of the candidate rows that is drawn.
    share: f32,
}

@group(0) @binding(0) var<uniform> draw: Sample;
@group(0) @binding(1) var<storage, read> sorted_keys: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read_write> row_of_place: array<u32>;
@group(0) @binding(4) var<storage, read_write> weights: array<f32>;

fn run(place: u32) {
    if (place >= draw.places) {
        return;
    }
    let candidates = present_count(draw.rows);
    let count = min(u32(ceil(draw.share * f32(candidates))), candidates);
    row_of_place[place] = order[place];
    weights[place] = select(0.0, 1.0, place < count);
}

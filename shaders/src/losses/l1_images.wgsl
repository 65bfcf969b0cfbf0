struct Distance {
    len: u32,
    factor: f32,
}

@group(0) @binding(0) var<uniform> l1: Distance;
@group(0) @binding(1) var<storage, read> render: array<f32>;
@group(0) @binding(2) var<storage, read> image: array<f32>;

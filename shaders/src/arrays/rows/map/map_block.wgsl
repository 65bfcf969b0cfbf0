// The constants of a row map: up to eight numbers, and the number of rows.

struct Map {
    values: array<vec4<f32>, 2>,
    rows: u32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
}

@group(0) @binding(0) var<uniform> map: Map;

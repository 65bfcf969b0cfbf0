// A tile of 16×16 pixels of one channel, and the surrounding pixels that its windows reach.

struct Image {
    width: u32,
    height: u32,
    channels: u32,
    // Number of pixels at each end of a row or column whose window does not count.
    margin: u32,
    // Tiles per row and per column of the image.
    columns: u32,
    rows: u32,
    // 1 over the number of windows.
    per_window: f32,
    padding: f32,
    // Weights of the window along one axis.
    weights: array<vec4<f32>, 3>,
}

@group(0) @binding(0) var<uniform> image: Image;

const RADIUS: i32 = 5;
const TAPS: u32 = 11u;
const TILE: u32 = 16u;
// Side and area of a tile with the reached pixels around it.
const REACH: u32 = 26u;
const REACHED: u32 = 676u;
// Elements that are filtered along rows: all reached rows of the tile's columns.
const FILTERED: u32 = 416u;

struct Tile {
    first_column: u32,
    first_row: u32,
    channel: u32,
    in_image: bool,
}

fn tile_of(group: u32) -> Tile {
    let place = group / image.channels;
    let row = place / image.columns;
    return Tile(place % image.columns * TILE, row * TILE, group % image.channels, row < image.rows);
}

fn weight(tap: u32) -> f32 {
    return image.weights[tap / 4u][tap % 4u];
}

// The pixel at a place of the reached area, as (column, row); x is negative outside the image.
fn reached_pixel(tile: Tile, place: u32) -> vec2<i32> {
    let column = i32(tile.first_column + place % REACH) - RADIUS;
    let pixel = vec2<i32>(column, i32(tile.first_row + place / REACH) - RADIUS);
    if (pixel.x < 0 || pixel.y < 0 || pixel.x >= i32(image.width) || pixel.y >= i32(image.height)) {
        return vec2<i32>(-1, -1);
    }
    return pixel;
}

// Index of the channel of a pixel in an interleaved image.
fn interleaved(tile: Tile, column: u32, row: u32) -> u32 {
    return (row * image.width + column) * image.channels + tile.channel;
}

// Index of the channel of a pixel in planes of one channel each.
fn planar(tile: Tile, column: u32, row: u32) -> u32 {
    return (tile.channel * image.height + row) * image.width + column;
}

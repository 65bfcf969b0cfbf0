// The values that a point samples from the planes, for one channel.
#import networks::hexplane::field
#extern fn gather_plane_xy(item: u32, at: vec4<u32>) -> vec4<f32>
#extern fn gather_plane_xz(item: u32, at: vec4<u32>) -> vec4<f32>
#extern fn gather_plane_xt(item: u32, at: vec4<u32>) -> vec4<f32>
#extern fn gather_plane_yz(item: u32, at: vec4<u32>) -> vec4<f32>
#extern fn gather_plane_yt(item: u32, at: vec4<u32>) -> vec4<f32>
#extern fn gather_plane_zt(item: u32, at: vec4<u32>) -> vec4<f32>

@group(0) @binding(1) var<storage, read> positions: array<f32>;

fn gather_texels(scale: u32, plane: u32, at: vec4<u32>) -> vec4<f32> {
    switch plane {
        case 0u: { return gather_plane_xy(scale, at); }
        case 1u: { return gather_plane_xz(scale, at); }
        case 2u: { return gather_plane_xt(scale, at); }
        case 3u: { return gather_plane_yz(scale, at); }
        case 4u: { return gather_plane_yt(scale, at); }
        default: {}
    }
    return gather_plane_zt(scale, at);
}

// An interpolated value, and its derivatives per texel along the plane's width and height.
struct Reading {
    value: f32,
    along_a: f32,
    along_b: f32,
}

// Samples a plane at `a` along its width and `b` along its height.
fn read_plane(scale: u32, plane: u32, a: Lookup, b: Lookup, channel: u32) -> Reading {
    let width = texels(scale, width_axis(plane));
    let rows = vec4<u32>(b.low, b.low, b.high, b.high) * width;
    let places = (rows + vec4<u32>(a.low, a.high, a.low, a.high)) * channels() + channel;
    let corners = gather_texels(scale, plane, places);
    let step_low = corners.y - corners.x;
    let step_high = corners.w - corners.z;
    let at_low = corners.x + step_low * a.fraction;
    let at_high = corners.z + step_high * a.fraction;
    let along_b = at_high - at_low;
    return Reading(at_low + along_b * b.fraction, step_low + (step_high - step_low) * b.fraction, along_b);
}

struct Readings {
    x: Lookup,
    y: Lookup,
    z: Lookup,
    xy: Reading,
    xz: Reading,
    yz: Reading,
    xt: Reading,
    yt: Reading,
    zt: Reading,
}

fn readings_of(scale: u32, point: u32, channel: u32) -> Readings {
    let x = lookup(positions[3u * point], texels(scale, 0u));
    let y = lookup(positions[3u * point + 1u], texels(scale, 1u));
    let z = lookup(positions[3u * point + 2u], texels(scale, 2u));
    let t = time_lookup(scale);
    return Readings(
        x,
        y,
        z,
        read_plane(scale, 0u, x, y, channel),
        read_plane(scale, 1u, x, z, channel),
        read_plane(scale, 3u, y, z, channel),
        read_plane(scale, 2u, x, t, channel),
        read_plane(scale, 4u, y, t, channel),
        read_plane(scale, 5u, z, t, channel),
    );
}

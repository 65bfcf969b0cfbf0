// What a point reads from the planes, for one channel.

@group(0) @binding(1) var<storage, read> positions: array<f32>;
@group(0) @binding(2) var<storage, read> plane_xy: array<f32>;
@group(0) @binding(3) var<storage, read> plane_xz: array<f32>;
@group(0) @binding(4) var<storage, read> plane_xt: array<f32>;
@group(0) @binding(5) var<storage, read> plane_yz: array<f32>;
@group(0) @binding(6) var<storage, read> plane_yt: array<f32>;
@group(0) @binding(7) var<storage, read> plane_zt: array<f32>;

fn texel(plane: u32, at: u32) -> f32 {
    switch plane {
        case 0u: { return plane_xy[at]; }
        case 1u: { return plane_xz[at]; }
        case 2u: { return plane_xt[at]; }
        case 3u: { return plane_yz[at]; }
        case 4u: { return plane_yt[at]; }
        default: {}
    }
    return plane_zt[at];
}

// The value and its derivatives along the plane's axes, in texels.
struct Reading {
    value: f32,
    along_a: f32,
    along_b: f32,
}

// The plane at a along its width and b along its height.
fn read_plane(plane: u32, a: Lookup, b: Lookup, width: u32, channel: u32) -> Reading {
    let low = b.low * width;
    let high = b.high * width;
    let low_low = texel(plane, (low + a.low) * scale.channels + channel);
    let low_high = texel(plane, (low + a.high) * scale.channels + channel);
    let high_low = texel(plane, (high + a.low) * scale.channels + channel);
    let high_high = texel(plane, (high + a.high) * scale.channels + channel);
    let step_low = low_high - low_low;
    let step_high = high_high - high_low;
    let at_low = low_low + step_low * a.fraction;
    let at_high = high_low + step_high * a.fraction;
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

fn readings_of(point: u32, channel: u32) -> Readings {
    let size = scale.resolution;
    let x = lookup(positions[3u * point], size.x);
    let y = lookup(positions[3u * point + 1u], size.y);
    let z = lookup(positions[3u * point + 2u], size.z);
    let t = time_lookup();
    return Readings(
        x,
        y,
        z,
        read_plane(0u, x, y, size.x, channel),
        read_plane(1u, x, z, size.x, channel),
        read_plane(3u, y, z, size.y, channel),
        read_plane(2u, x, t, size.x, channel),
        read_plane(4u, y, t, size.y, channel),
        read_plane(5u, z, t, size.z, channel),
    );
}


// What a point reads from the planes, for one channel.

@group(0) @binding(1) var<storage, read> positions: array<f32>;

fn texel(scale: u32, plane: u32, at: u32) -> f32 {
    switch plane {
        case 0u: { return plane_xy(scale, at); }
        case 1u: { return plane_xz(scale, at); }
        case 2u: { return plane_xt(scale, at); }
        case 3u: { return plane_yz(scale, at); }
        case 4u: { return plane_yt(scale, at); }
        default: {}
    }
    return plane_zt(scale, at);
}

// The value and its derivatives along the plane's axes, in texels.
struct Reading {
    value: f32,
    along_a: f32,
    along_b: f32,
}

// The plane at a along its width and b along its height.
fn read_plane(scale: u32, plane: u32, a: Lookup, b: Lookup, channel: u32) -> Reading {
    let width = texels(scale, width_axis(plane));
    let low = b.low * width;
    let high = b.high * width;
    let low_low = texel(scale, plane, (low + a.low) * channels() + channel);
    let low_high = texel(scale, plane, (low + a.high) * channels() + channel);
    let high_low = texel(scale, plane, (high + a.low) * channels() + channel);
    let high_high = texel(scale, plane, (high + a.high) * channels() + channel);
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


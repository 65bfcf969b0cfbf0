// The phases of a row's waves at the time since its centre: the same definitions as on the CPU.

struct Waves {
    time: f32,
    rows: u32,
    // Waves per row.
    waves: u32,
    // Values per wave, and the number of them in use.
    stored: u32,
    used: u32,
}

@group(0) @binding(0) var<uniform> sizes: Waves;

const TAU: f32 = 6.283185307179586;

// 2πn·offset less whole turns, because sine and cosine are only accurate near zero.
fn phase_of(wave: u32, offset: f32) -> f32 {
    let turns = f32(wave + 1u) * offset;
    return TAU * (turns - round(turns));
}

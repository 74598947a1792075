//! Numbers that look like chance and are not: pure functions of a key.

/// The finalizer of SplitMix64 (G. Steele et al., OOPSLA 2014).
pub fn mix(key: u64) -> u64 {
    let key = key.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let key = (key ^ key >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let key = (key ^ key >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    key ^ key >> 31
}

/// Bits of a chance: three are drawn at once.
const CHANCE_BITS: u32 = 21;

/// Three numbers in [0, 1), each a multiple of 2^-21.
pub fn chances(key: u64) -> [f32; 3] {
    let (mixed, most) = (mix(key), 1u32 << CHANCE_BITS);
    [0, 1, 2].map(|c| ((mixed >> (c * CHANCE_BITS)) as u32 & (most - 1)) as f32 / most as f32)
}

//! See `trex_fuzz::gltf`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::gltf(bytes));

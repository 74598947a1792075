//! See `trex_fuzz::ply`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::ply(bytes));

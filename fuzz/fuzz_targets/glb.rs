//! See `trex_fuzz::glb`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::glb(bytes));

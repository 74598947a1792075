//! See `trex_fuzz::mtl`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::mtl(bytes));

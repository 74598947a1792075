//! See `trex_fuzz::stl`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::stl(bytes));

//! See `trex_fuzz::scene`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::scene(bytes));

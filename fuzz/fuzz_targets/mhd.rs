//! See `trex_fuzz::mhd`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::mhd(bytes));

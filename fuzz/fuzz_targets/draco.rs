//! See `trex_fuzz::draco`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::draco(bytes));

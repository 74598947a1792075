//! See `trex_fuzz::units`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::units(bytes));

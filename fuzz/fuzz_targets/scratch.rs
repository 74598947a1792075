//! See `trex_fuzz::scratch`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::scratch(bytes));

//! See `trex_fuzz::raw`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::raw(bytes));

//! See `trex_fuzz::views`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::views(bytes));

//! See `trex_fuzz::page_file`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::page_file(bytes));

//! See `trex_fuzz::obj`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::obj(bytes));

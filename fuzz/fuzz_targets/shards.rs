//! See `trex_fuzz::plans_and_fragments`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::plans_and_fragments(bytes));

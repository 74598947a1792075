//! See `trex_fuzz::nrrd`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::nrrd(bytes));

//! See `trex_fuzz::parts::normals`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| trex_fuzz::parts::normals(bytes));

//! trex-render: rays to picture.

pub mod trace;

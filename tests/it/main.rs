//! Integration tests of trex, one binary: a module per theme.

mod oracle;
mod rays;
mod support;

//! Integration tests of trex, one binary: a module per theme.

mod cli;
mod oracle;
mod rays;
mod support;
mod tidy;

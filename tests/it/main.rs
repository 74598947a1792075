//! Integration tests of trex, one binary: a module per theme.

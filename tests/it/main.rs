//! Integration tests of trex, one binary: a module per theme.

mod cgroup;
mod cli;
mod command;
mod contract;
mod damage;
mod determinism;
mod examples;
mod extremes;
mod format;
mod format_octree;
mod format_units;
mod image_diff;
mod inputs;
mod lies;
mod light;
mod limits;
mod live;
mod memory;
mod oracle;
mod outputs;
mod rays;
mod real_models;
mod support;
mod tidy;
mod voxels;

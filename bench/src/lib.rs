//! Workloads, records, peers and the docs written from them.

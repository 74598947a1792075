//! trex-bench: workloads, peers, and the figures that were measured with them.
//!
//! ```text
//! trex VERB --json -> record::Record -> bench/record/NAME.jsonl -> docs -> figures of README.md and docs/
//!   ^ rays, building: workloads on a model, some beside a peer of `peers`
//!   ^ estimates: medians of the criterion benches, which have a package of their own; view_rays: the rays of some
//!   ^ page_io: pages at random, through each backend
//!   ^ smooth: what a viewer shows of few samples, to be judged beside another filter
//!   ^ eviction: the pool's clock beside LRU and the optimum, on the pages that a session asks for
//!   ^ stress: a session under views and limits that change
//!   ^ tradeoff: pictures for each turn of each knob, their cost and their error
//!   ^ scale: models of rising size, from their build to their rays, and the exponents of what they cost
//! ```
//!
//! Invariant: a figure in the documentation comes from a record, and a record says how to get it again.

pub mod building;
mod campaign;
mod channels;
pub mod docs;
pub mod estimates;
pub mod eviction;
mod full_pool;
pub mod machine;
pub mod median;
pub mod model;
pub mod page_io;
mod peers;
mod plot;
pub mod rays;
pub mod record;
pub mod scale;
pub mod smooth;
pub mod stress;
pub mod tradeoff;
pub mod view_rays;

//! trex-store: from a triangle mesh to a page file, and from the page file to memory, under a limit.

mod budget;
pub mod build;
mod chain;
pub mod cluster;
mod error;
mod file;
pub mod geom;
pub mod import;
pub mod io;
pub mod layout;
mod material;
pub mod pool;
mod progress;
mod source;
pub mod verify;

pub use budget::{Budget, Lease, RESERVE_BYTES};
pub use chain::Chain;
pub use error::{Code, Error, Result};
pub use file::{Emitter, PageFile};
pub use geom::{Aabb, Lattice};
pub use material::Material;
pub use progress::{Interrupt, Progress, Report};
pub use source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};

//! trex-store: from a triangle mesh to a page file, and from the page file to memory, under a limit.
//!
//! # Life of a triangle
//!
//! [`import`] (or a generator) delivers it in a [`TriangleBatch`]. [`build::build`] snaps its corners to the model's
//! [`Lattice`], sorts it into a cell in scratch, and puts it into a cluster of up to 128 ([`cluster`]), the cluster
//! into a page, the page into the file ([`layout`]), which appears when it is whole. [`PageFile`] opens that file and
//! its tables; [`pool::PagePool`] reads pages through [`io`] when somebody asks, checks their hash and installs them in
//! frames, where they are traced as they lie ([`cluster::FrameView`]). [`verify`] reads every byte.
//!
//! All memory is leased from a [`Budget`] before it is taken. The crate knows no rays, prints nothing, and keeps no
//! globals.

mod attributes;
mod budget;
pub mod build;
mod chain;
pub mod cluster;
mod crease;
mod damage;
mod error;
mod export;
mod file;
pub mod geom;
pub mod import;
pub mod io;
pub mod layout;
pub mod marching_cubes;
mod material;
mod material_json;
mod material_list;
mod material_names;
mod next_step;
pub mod octree;
pub mod output;
mod plain_source;
pub mod pool;
pub mod printable;
mod progress;
mod scratch;
mod source;
mod source_scene;
mod spool;
pub mod srgb;
mod stamp;
pub mod stated_lattice;
mod url;
pub mod verify;

pub use attributes::{AttributeColumns, AttributeSet, CornerAttributes};
pub use budget::{Budget, Lease, RESERVE_BYTES};
pub use chain::Chain;
pub use crease::{CreaseOptions, CreasedSource};
pub use damage::{DamageList, DamagedPage};
pub use error::{Code, Error, Result};
pub use export::{ExportOptions, PageTriangles};
pub use file::{Emitter, FileSizes, PageFile, open_regular};
pub use geom::{Aabb, Lattice};
pub use material::Material;
pub use material_list::MaterialList;
pub use material_names::{MaterialNames, stored_name};
pub use next_step::{NextStep, Setting};
pub use plain_source::PlainSource;
pub use progress::{Interrupt, Progress, Report, StopSignal};
pub use source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};
pub use source_scene::{SourceCamera, SourceLight, SourceScene};
pub use spool::{SpooledSource, TriangleSpool};
pub use stamp::{content_stamp, stamp};
pub use url::is_url;

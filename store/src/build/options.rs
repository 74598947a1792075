//! Options of a build.
//!
//! Invariant: the bytes of the output depend on `precision` and `voxels` alone.

use crate::budget::Budget;
use crate::octree::Refinement;
use crate::output::ExistingOutput;
use crate::progress::Interrupt;
use rayon::ThreadPool;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// How the lattice step is chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Precision {
    /// Half a step is at most 1/128 of the median edge and 2^-17 of the extent.
    Default,
    /// The extent takes so many bits, 1 to 40.
    GridBits(u32),
    /// Half a step is at most this, model units.
    Error(f64),
}

/// Which voxel octree goes into the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Voxels {
    /// None: no global illumination from this file.
    None,
    /// As fine as the model's own bytes and this much resident memory allow.
    Within {
        /// Most bytes of the resident octree, without light.
        upper_bytes: u64,
    },
    /// So many leaves along the longest side: 64, 256, 512 or 1024.
    Resolution(u32),
    /// So many leaves that are resident, with finer ones below them that are read when they are asked for.
    Refined {
        /// Leaves of the resident octree along the longest side: 64, 256, 512 or 1024.
        upper: u32,
        /// How much finer the finest ones are.
        refinement: Refinement,
    },
}

impl Default for Voxels {
    fn default() -> Voxels {
        Voxels::Within { upper_bytes: 64 << 20 }
    }
}

/// Options of a build. The bytes of the output depend on `precision` and `voxels` alone.
#[derive(Clone, Debug)]
pub struct BuildOptions {
    /// The lattice.
    pub precision: Precision,
    /// The voxel octree.
    pub voxels: Voxels,
    /// The threads that chunks are built on. A build is called from another thread: it waits for these.
    pub pool: Arc<ThreadPool>,
    /// Where memory is leased from.
    pub budget: Budget,
    /// Folder of the scratch file; `None` = the output's folder.
    pub temp_dir: Option<PathBuf>,
    /// Whether an output that exists is kept or replaced.
    pub existing: ExistingOutput,
    /// Stops the build when raised.
    pub interrupt: Interrupt,
    /// How a build that is killed or interrupted resumes when it is started again; `None`: it leaves nothing.
    pub resume: Option<Resume>,
}

/// What a build does so that it can resume after it was killed.
#[derive(Clone, Debug)]
pub struct Resume {
    /// What distinguishes the input from others, by name: paths, lengths, times. A build resumes with the same input
    /// only.
    pub input: Vec<(String, String)>,
    /// About how much work a kill may cost, once the input has been read.
    pub every: Duration,
}

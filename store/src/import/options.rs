//! `ImportOptions`: how an input is read.

use super::scalar::ByteOrder;
use super::volume::SampleType;
use crate::budget::Budget;
use crate::progress::Interrupt;
use std::path::{Path, PathBuf};

/// What is kept of the names of materials.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MaterialNaming {
    /// The names.
    #[default]
    Names,
    /// A hash of each, in its place, while memory is leased as for the names: to tell what reading takes, in less.
    Hashes,
}

/// How volumes are read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VolumeOptions {
    /// The values of their surfaces, finite: what is a value or more is inside. Each surface has a material of its own.
    pub iso_values: Vec<f64>,
    /// What files of plain samples hold.
    pub raw: Option<RawVolume>,
}

/// A volume whose file has no header.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawVolume {
    /// Samples along each axis, those that lie side by side first.
    pub size: [u64; 3],
    /// Their type.
    pub sample: SampleType,
    /// The order of their bytes.
    pub order: ByteOrder,
    /// From a sample to the next one along each axis.
    pub spacing: [f64; 3],
}

/// What becomes of the pictures that materials have their colours from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TextureUse {
    /// Each vertex gets the colour of its place in the picture.
    #[default]
    Sampled,
    /// Each material gets the mean of its picture: for who drops the colours of vertices.
    Mean,
}

/// How an input is read.
#[derive(Clone, Debug)]
pub struct ImportOptions {
    /// Where all memory is leased.
    pub budget: Budget,
    /// Folder of the unlinked scratch file that vertices go to when they neither fit the cache nor lie in the
    /// input as plain numbers.
    pub temp_dir: PathBuf,
    /// Stops the reading, at the latest after one window.
    pub interrupt: Interrupt,
    /// Most bytes that the vertex cache takes. Less is taken where the array is smaller or the budget has less.
    pub vertex_cache_bytes: u64,
    /// Most bytes that a description is held in which has to be parsed as a whole (the JSON of glTF), also where the
    /// budget has no limit, as of those who only count.
    pub held_bytes: u64,
    /// What is kept of the names of materials.
    pub naming: MaterialNaming,
    /// What becomes of pictures.
    pub textures: TextureUse,
    /// How volumes are read.
    pub volumes: VolumeOptions,
}

impl ImportOptions {
    /// Options under `budget`, a quarter of which may go to the vertex cache.
    pub fn new(budget: Budget, temp_dir: &Path) -> ImportOptions {
        let (vertex_cache_bytes, held_bytes) = (budget.free_bytes() / 4, budget.free_bytes());
        ImportOptions {
            budget,
            temp_dir: temp_dir.to_path_buf(),
            interrupt: Interrupt::default(),
            vertex_cache_bytes,
            held_bytes,
            naming: MaterialNaming::default(),
            textures: TextureUse::default(),
            volumes: VolumeOptions::default(),
        }
    }

    /// Options without a limit, for tests and small tools.
    pub fn unlimited(temp_dir: &Path) -> ImportOptions {
        ImportOptions::new(Budget::unlimited(), temp_dir)
    }
}

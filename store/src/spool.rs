//! `TriangleSpool`: triangles that come once, kept in scratch, so that a build can read them as often as it does.
//!
//! ```text
//! push, push .. -> a block of triangles -> scratch     finish -> SpooledSource -> blocks, from the first on
//! block = seal | corners, 9 x f64 a triangle | material, u32 a triangle
//! ```
//!
//! Invariants: 1. all blocks but the last are full, so a block's place follows from its number, which is its name too;
//! 2. memory is a block as numbers and one as bytes, leased with the spool.

use crate::budget::{Budget, Lease};
use crate::error::{Code, Error, Result};
use crate::layout::MATERIALS;
use crate::material::Material;
use crate::material_list::MaterialList;
use crate::scratch::{SEAL_BYTES, ScratchFile, seal};
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};
use std::path::Path;

/// Triangles of a full block.
const BLOCK_TRIANGLES: usize = TriangleBatch::TARGET_TRIANGLES;
/// Bytes of a triangle in a block.
const TRIANGLE_BYTES: usize = 9 * 8 + 4;
/// Bytes of a full block.
const BLOCK_BYTES: usize = SEAL_BYTES + BLOCK_TRIANGLES * TRIANGLE_BYTES;
/// What the lists of materials are called in messages.
const MATERIALS_LEASED: &str = "the materials of the spool";

/// Takes triangles. Give them with [`TriangleSpool::push`], then [`TriangleSpool::finish`].
pub struct TriangleSpool {
    scratch: ScratchFile,
    name: String,
    /// Those that no block was written of.
    pending: TriangleBatch,
    bytes: Vec<u8>,
    written: u64,
    materials: MaterialList,
    text_bytes: u64,
    budget: Budget,
    /// Of the blocks, and of the materials.
    leases: [Lease; 2],
}

impl TriangleSpool {
    /// An empty spool of the material [`Material::default`], in a file without a name in `folder`. `name` is for
    /// messages.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] where `budget` has no room for two blocks (2.5 MiB); those of making the file.
    pub fn create(folder: &Path, name: &str, budget: &Budget) -> Result<TriangleSpool> {
        let block = budget.lease("a block of the spool", 2 * BLOCK_BYTES as u64)?;
        Ok(TriangleSpool {
            scratch: ScratchFile::create(folder)?,
            name: name.to_owned(),
            pending: TriangleBatch::default(),
            bytes: Vec::with_capacity(BLOCK_BYTES),
            written: 0,
            materials: MaterialList::from(Material::default()),
            text_bytes: 0,
            leases: [block, budget.lease(MATERIALS_LEASED, 0)?],
            budget: budget.clone(),
        })
    }

    /// Adds a material. Gives its index.
    ///
    /// # Errors
    /// [`Code::InputRange`] where a model can have no more; [`Code::MemoryLimit`].
    pub fn add_material(&mut self, name: &str, material: Material) -> Result<u32> {
        let index = self.materials.len();
        if index >= MATERIALS {
            return Err(Error::new(Code::InputRange, "the input has too many materials")
                .at_place(&self.name)
                .numbers(format!("more than {MATERIALS}"))
                .next("give fewer of them"));
        }
        self.text_bytes += name.len() as u64;
        let bytes = MaterialList::bytes(index as u64 + 1, self.text_bytes);
        let lease = &mut self.leases[1];
        lease.grow(MATERIALS_LEASED, bytes.saturating_sub(lease.bytes()))?;
        self.materials.push(name, material.checked());
        Ok(index as u32)
    }

    /// Adds a triangle.
    ///
    /// # Errors
    /// Those of writing to the file.
    ///
    /// # Panics
    /// For a material that was not added.
    pub fn push(&mut self, corners: [[f64; 3]; 3], material: u32) -> Result<()> {
        assert!((material as usize) < self.materials.len(), "material {material} was not added");
        self.pending.push(corners, material);
        if self.pending.len() == BLOCK_TRIANGLES { self.write_block() } else { Ok(()) }
    }

    /// Triangles so far.
    pub fn triangle_count(&self) -> u64 {
        self.written * BLOCK_TRIANGLES as u64 + self.pending.len() as u64
    }

    /// All of them as a source.
    ///
    /// # Errors
    /// Those of writing to the file.
    pub fn finish(mut self) -> Result<SpooledSource> {
        let count = self.triangle_count();
        if !self.pending.is_empty() {
            self.write_block()?;
        }
        let stats = SourceStats {
            bytes_total: count * TRIANGLE_BYTES as u64,
            material_name_bytes: self.text_bytes,
            ..SourceStats::default()
        };
        Ok(SpooledSource { spool: self, count, next: 0, stats })
    }

    fn write_block(&mut self) -> Result<()> {
        let TriangleSpool { scratch, pending, bytes, written, .. } = self;
        bytes.clear();
        bytes.resize(SEAL_BYTES, 0);
        bytes.extend(pending.corners.iter().flatten().flatten().flat_map(|x| x.to_le_bytes()));
        bytes.extend(pending.material.iter().flat_map(|material| material.to_le_bytes()));
        seal(bytes, *written);
        scratch.write(bytes, *written * BLOCK_BYTES as u64)?;
        pending.clear();
        *written += 1;
        Ok(())
    }
}

/// The triangles of a [`TriangleSpool`], in the order in which they came.
pub struct SpooledSource {
    spool: TriangleSpool,
    count: u64,
    /// The next triangle.
    next: u64,
    stats: SourceStats,
}

impl SpooledSource {
    /// The ledger that the spool is leased from.
    pub fn budget(&self) -> &Budget {
        &self.spool.budget
    }
}

impl TriangleSource for SpooledSource {
    fn name(&self) -> String {
        self.spool.name.clone()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        batch.clear();
        let count = (self.count - self.next).min(BLOCK_TRIANGLES as u64) as usize;
        if count == 0 {
            return Ok(false);
        }
        let block = self.next / BLOCK_TRIANGLES as u64;
        let TriangleSpool { scratch, bytes, .. } = &mut self.spool;
        let length = SEAL_BYTES + count * TRIANGLE_BYTES;
        let content = scratch.read(block * BLOCK_BYTES as u64, length, block, bytes)?;
        let (corners, materials) = content.split_at(count * 9 * 8);
        let number = |bytes: &[u8]| f64::from_le_bytes(bytes.try_into().expect("eight bytes"));
        batch.corners.extend(corners.chunks_exact(9 * 8).map(|triangle| {
            std::array::from_fn(|corner| {
                std::array::from_fn(|axis| number(&triangle[(3 * corner + axis) * 8..][..8]))
            })
        }));
        let index = |bytes: &[u8]| u32::from_le_bytes(bytes.try_into().expect("four bytes"));
        batch.material.extend(materials.chunks_exact(4).map(index));
        self.next += count as u64;
        self.stats.triangle_count = self.next;
        self.stats.bytes_read = self.next * TRIANGLE_BYTES as u64;
        Ok(true)
    }

    fn rewind(&mut self) -> Result<()> {
        self.next = 0;
        (self.stats.triangle_count, self.stats.bytes_read) = (0, 0);
        Ok(())
    }

    fn hint(&self) -> Option<ScanHint> {
        None
    }

    fn materials(&self) -> &MaterialList {
        &self.spool.materials
    }

    fn stats(&self) -> SourceStats {
        self.stats.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A triangle that tells its number.
    fn triangle(number: u64) -> [[f64; 3]; 3] {
        std::array::from_fn(|corner| {
            std::array::from_fn(|axis| number as f64 + (3 * corner + axis) as f64 / 9.0)
        })
    }

    fn read_all(source: &mut SpooledSource) -> Vec<([[f64; 3]; 3], u32)> {
        let (mut all, mut batch) = (vec![], TriangleBatch::default());
        while source.next_batch(&mut batch).unwrap() {
            all.extend(batch.corners.iter().copied().zip(batch.material.iter().copied()));
        }
        assert!(batch.is_empty());
        all
    }

    #[test]
    fn what_went_in_comes_back_as_often_as_it_is_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let budget = Budget::new(64 << 20);
        for count in [0, 1, BLOCK_TRIANGLES as u64, 2 * BLOCK_TRIANGLES as u64 + 7] {
            let mut spool = TriangleSpool::create(folder.path(), "a list", &budget).unwrap();
            let red = spool.add_material("red", Material { kd: [0.5, 0.0, 0.0], ..Material::default() });
            assert_eq!(red.unwrap(), 1);
            for number in 0..count {
                spool.push(triangle(number), (number % 2) as u32).unwrap();
            }
            assert_eq!(spool.triangle_count(), count);
            let mut source = spool.finish().unwrap();
            let expected: Vec<_> = (0..count).map(|number| (triangle(number), (number % 2) as u32)).collect();
            for _ in 0..2 {
                assert!(read_all(&mut source) == expected, "{count}");
                assert_eq!(source.stats().triangle_count, count);
                source.rewind().unwrap();
            }
            assert_eq!((source.materials().len(), source.materials().name(1)), (2, "red"));
            drop(source);
            assert_eq!(budget.used_bytes(), 0);
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "the file has no name");
        }
    }

    #[test]
    fn a_bit_that_turned_is_no_triangle() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = TriangleSpool::create(folder.path(), "a list", &Budget::unlimited()).unwrap();
        (0..100).for_each(|number| spool.push(triangle(number), 0).unwrap());
        let mut source = spool.finish().unwrap();
        source.spool.scratch.flip(8 * 1000);
        assert_eq!(source.next_batch(&mut TriangleBatch::default()).unwrap_err().code(), Code::Io);
    }

    #[test]
    fn materials_are_bounded_and_leased() {
        let folder = tempfile::tempdir().unwrap();
        let budget = Budget::new(64 << 20);
        let mut spool = TriangleSpool::create(folder.path(), "a list", &budget).unwrap();
        let before = budget.used_bytes();
        for index in 1..MATERIALS as u32 {
            assert_eq!(spool.add_material("a", Material::default()).unwrap(), index);
        }
        assert!(budget.used_bytes() > before + (MATERIALS * size_of::<Material>()) as u64);
        let error = spool.add_material("a", Material::default()).unwrap_err();
        assert_eq!((error.code(), error.place()), (Code::InputRange, "a list"));
        let tight = TriangleSpool::create(folder.path(), "a list", &Budget::new(crate::RESERVE_BYTES + 1000));
        assert_eq!(tight.err().unwrap().code(), Code::MemoryLimit);
    }
}

//! Finest records in key order to units, to pages, and to the records of the upper octree. Paper, section 4.2.
//!
//! ```text
//! records of one linking node -> leaves of each level below the upper ones = a family -> scratch file, key order
//!                             -> records of its upper leaves -> UpperBuilder
//! families along the Hilbert curve: finest units -> pages;  then the units that lead to them -> pages
//! ```
//!
//! Why the curve: keys follow rows of 4x4x4 nodes, which jump; along the curve neighbours share a page, and the next
//! page lies beside it in the model.
//!
//! Invariants: 1. a page is filled until the next unit does not fit; 2. memory is a family, and for each linking node
//! its place and word (and, where units nest, a word for each upper leaf while pages are made); 3. a family in the
//! scratch file is named by its offset.

use super::coarsen::{Coarser, OpenLeaf};
use super::links::{LowerLinks, PAGE_UNITS, UnitRef};
use super::payload::LeafNormal;
use super::record::Record;
use super::units::{StoredUnits, UnitCounts, Units, material_bytes};
use super::{KEY_BITS, Refinement, UpperBuilder, VoxelGrid, place_of};
use crate::error::Result;
use crate::geom::hilbert_key;
use crate::layout::{FRAME_BYTES, PAGES, too_many_pages};
use crate::scratch::{SEAL_BYTES, ScratchFile, seal};
use std::path::Path;

/// Bytes of a material in the scratch file.
const SCRATCH_MATERIAL_BYTES: usize = 2;
/// Bytes of a leaf's words, and how many copies of a family there are while it is packed.
const WORK_LEAF_BYTES: u64 = 4 * (8 + 2 + 2);
/// Bytes of families that are written together.
const WRITE_BYTES: usize = 64 << 10;

/// Makes units and upper records of the finest records.
pub(crate) struct LowerBuilder {
    upper: UpperBuilder,
    grid: VoxelGrid,
    refinement: Refinement,
    /// From the one below the upper leaves to the finest.
    levels: Vec<FamilyLevel>,
    /// Key of the linking node at hand.
    open: Option<u64>,
    families: Vec<Family>,
    scratch: ScratchFile,
    /// The end of what was made, which `unwritten` is the last part of.
    scratch_bytes: u64,
    unwritten: Vec<u8>,
    leaf_count: u64,
}

/// One level of leaves of the family at hand.
#[derive(Default)]
struct FamilyLevel {
    leaf: OpenLeaf,
    coarser: Coarser,
    units: Units,
    /// Key of the last leaf in `units`.
    last: Option<u64>,
}

/// A linking node: its place on the curve, and where its leaves stand in the scratch file.
struct Family {
    place: u64,
    offset: u64,
    bytes: u32,
    unpacked_bytes: u32,
}

/// Where pages of units begin.
#[derive(Clone, Copy)]
pub(crate) struct FirstPage {
    /// Number of the first one.
    pub(crate) number: u32,
    /// Materials of the model.
    pub(crate) material_count: usize,
}

/// What [`LowerBuilder::finish`] leaves to be written.
pub(crate) struct FamilyOutcome {
    pub(crate) upper: UpperBuilder,
    /// The section of links, and the count of its words; `None` where the upper leaves are the finest.
    pub(crate) links: Option<(Vec<u8>, usize)>,
    /// Leaves of all units.
    pub(crate) leaf_count: u64,
}

/// Most bytes of memory that the family at hand takes.
pub(crate) fn family_bytes(refinement: Refinement) -> u64 {
    WORK_LEAF_BYTES << (KEY_BITS as usize * (refinement.levels() + 1))
}

impl LowerBuilder {
    /// For an upper octree on `grid`; scratch files go to `folder`.
    pub(crate) fn new(grid: VoxelGrid, refinement: Refinement, folder: &Path) -> Result<LowerBuilder> {
        Ok(LowerBuilder {
            upper: UpperBuilder::new(grid, folder)?,
            grid,
            refinement,
            levels: (0..refinement.levels()).map(|_| FamilyLevel::default()).collect(),
            open: None,
            families: Vec::new(),
            scratch: ScratchFile::create(folder)?,
            scratch_bytes: 0,
            unwritten: Vec::new(),
            leaf_count: 0,
        })
    }

    /// Bytes of memory that grow with the model, while records are pushed and once more while they are written.
    pub(crate) fn grown_bytes(&self) -> u64 {
        self.upper.masks_bytes() + (self.families.capacity() * size_of::<Family>()) as u64
    }

    /// Bytes of memory that `finish` takes beside these: order and words of families, words of nested units.
    pub(crate) fn finish_bytes(&self) -> u64 {
        let nested = if self.levels.len() > 1 { u64::from(self.upper.leaf_count()) } else { 0 };
        (2 * self.families.len() as u64 + nested) * size_of::<u32>() as u64
    }

    /// Bytes in the scratch file.
    pub(crate) fn scratch_bytes(&self) -> u64 {
        self.scratch_bytes
    }

    /// Adds what one material brings to a finest leaf; keys never go back.
    pub(crate) fn push(&mut self, record: Record) -> Result<()> {
        let Some(finest) = self.levels.len().checked_sub(1) else { return self.upper.push(record) };
        let family = record.key() >> (KEY_BITS as usize * (self.levels.len() + 1));
        if self.open != Some(family) {
            self.end_family()?;
            self.open = Some(family);
        }
        self.add(finest, record)
    }

    /// Adds a record of `level`, and to the level above it what that completes.
    fn add(&mut self, level: usize, record: Record) -> Result<()> {
        let FamilyLevel { leaf, coarser, .. } = &mut self.levels[level];
        let (leaf, parents) = (leaf.push(record), coarser.push(&record));
        self.completed(level, leaf, parents)
    }

    /// A leaf of `level` and the records of a leaf of the level above it.
    fn completed(&mut self, level: usize, leaf: Option<Record>, parents: Vec<Record>) -> Result<()> {
        leaf.iter().for_each(|leaf| self.levels[level].take(leaf));
        parents.into_iter().try_for_each(|parent| match level.checked_sub(1) {
            Some(above) => self.add(above, parent),
            None => self.upper.push(parent),
        })
    }

    fn end_family(&mut self) -> Result<()> {
        let Some(key) = self.open.take() else { return Ok(()) };
        let mut bytes = Vec::new();
        for level in (0..self.levels.len()).rev() {
            let FamilyLevel { leaf, coarser, .. } = &mut self.levels[level];
            let (leaf, parents) = (leaf.close(), coarser.close());
            self.completed(level, leaf, parents)?;
            let FamilyLevel { units, last, .. } = &mut self.levels[level];
            self.leaf_count += units.bitmaps.len() as u64;
            let stored = units.encode(SCRATCH_MATERIAL_BYTES);
            bytes.extend((stored.len() as u32).to_le_bytes());
            bytes.extend(stored);
            units.clear();
            *last = None;
        }
        let begin = self.unwritten.len();
        self.unwritten.extend([0; SEAL_BYTES]);
        self.unwritten.extend(lz4_flex::block::compress(&bytes));
        let block = &mut self.unwritten[begin..];
        seal(block, self.scratch_bytes);
        let above = self.grid.depth() - 1;
        let place = hilbert_key(place_of(key, above), 2 * above as u32);
        let (offset, block_bytes) = (self.scratch_bytes, block.len() as u32);
        let family = Family { place, offset, bytes: block_bytes, unpacked_bytes: bytes.len() as u32 };
        self.families.push(family);
        self.scratch_bytes += u64::from(block_bytes);
        if self.unwritten.len() >= WRITE_BYTES { self.write() } else { Ok(()) }
    }

    fn write(&mut self) -> Result<()> {
        self.scratch.write(&self.unwritten, self.scratch_bytes - self.unwritten.len() as u64)?;
        self.unwritten.clear();
        Ok(())
    }

    /// Gives the stored form of each page of units, before packing, to `put`; they are numbered from the first one on.
    ///
    /// # Errors
    /// Those of scratch files and of `put`; [`Code::InputRange`] when there are more pages than a file can have.
    pub(crate) fn finish(
        mut self,
        FirstPage { number, material_count }: FirstPage,
        put: &mut dyn FnMut(Vec<u8>) -> Result<()>,
    ) -> Result<FamilyOutcome> {
        self.end_family()?;
        if self.levels.is_empty() {
            return Ok(FamilyOutcome { upper: self.upper, links: None, leaf_count: 0 });
        }
        self.write()?;
        let mut order: Vec<u32> = (0..self.families.len() as u32).collect();
        order.sort_unstable_by_key(|&family| self.families[family as usize].place);
        let mut pages = PagePacker {
            next: number,
            material_bytes: material_bytes(material_count),
            open: Units::default(),
            put,
        };
        let (mut words, mut nested) = (vec![0; order.len()], Vec::new());
        for level in (0..self.levels.len()).rev() {
            let mut below = nested.into_iter();
            nested = Vec::new();
            for &family in &order {
                let bytes = self.families[family as usize].read(&self.scratch)?;
                let stored = part(&bytes, self.levels.len() - 1 - level);
                let mut begin = UnitCounts::default();
                for &nodes in stored.units {
                    let links: Vec<u32> = below.by_ref().take(usize::from(nodes)).collect();
                    let word = pages.add(&stored, &mut begin, &links)?.word();
                    if level == 0 {
                        words[family as usize] = word;
                    } else {
                        nested.push(word);
                    }
                }
            }
            pages.close()?;
        }
        let links = LowerLinks::to_bytes(self.refinement, self.leaf_count, &words);
        Ok(FamilyOutcome {
            upper: self.upper,
            links: Some((links, words.len())),
            leaf_count: self.leaf_count,
        })
    }
}

/// The stored form of one level of a family, the finest being the first.
fn part(bytes: &[u8], index: usize) -> StoredUnits<'_> {
    let mut rest = bytes;
    for _ in 0..index {
        let (length, tail) = rest.split_first_chunk().expect("our own bytes");
        rest = &tail[u32::from_le_bytes(*length) as usize..];
    }
    let (length, tail) = rest.split_first_chunk().expect("our own bytes");
    let stored = StoredUnits::read(&tail[..u32::from_le_bytes(*length) as usize], SCRATCH_MATERIAL_BYTES);
    stored.expect("our own bytes")
}

impl FamilyLevel {
    /// Appends a leaf to its node, and that to its unit.
    fn take(&mut self, leaf: &Record) {
        let key = leaf.key();
        let is_first = |bits: u32| self.last.is_none_or(|last| last >> bits != key >> bits);
        let Units { units, nodes, bitmaps, normals, materials, .. } = &mut self.units;
        if is_first(2 * KEY_BITS) {
            units.push(0);
        }
        if is_first(KEY_BITS) {
            nodes.push(0);
            *units.last_mut().expect("just pushed") += 1;
        }
        *nodes.last_mut().expect("just pushed") += 1;
        bitmaps.push(leaf.bitmap);
        let surface = leaf.surface();
        normals.push(LeafNormal::pack(surface.normal, surface.flatness).0);
        materials.push(leaf.material());
        self.last = Some(key);
    }
}

impl Family {
    fn read(&self, scratch: &ScratchFile) -> Result<Vec<u8>> {
        let mut packed = Vec::new();
        let packed = scratch.read(self.offset, self.bytes as usize, self.offset, &mut packed)?;
        let mut bytes = vec![0; self.unpacked_bytes as usize];
        let unpacked = lz4_flex::block::decompress_into(packed, &mut bytes);
        if unpacked.ok() == Some(bytes.len()) { Ok(bytes) } else { Err(scratch.damaged(self.offset)) }
    }
}

/// Fills one page after the other.
struct PagePacker<'a> {
    open: Units,
    /// Number of the open page.
    next: u32,
    material_bytes: usize,
    put: &'a mut dyn FnMut(Vec<u8>) -> Result<()>,
}

impl PagePacker<'_> {
    /// Copies the unit of `from` whose first unit, node and leaf are `begin`, and moves `begin` to the next one.
    fn add(&mut self, from: &StoredUnits<'_>, begin: &mut UnitCounts, links: &[u32]) -> Result<UnitRef> {
        let nodes = &from.nodes[begin.nodes..][..usize::from(from.units[begin.units])];
        let leaves = nodes.iter().map(|&count| usize::from(count)).sum::<usize>();
        let open = self.open.counts();
        let sum = UnitCounts {
            units: open.units + 1,
            nodes: open.nodes + nodes.len(),
            leaves: open.leaves + leaves,
            links: open.links + links.len(),
        };
        if sum.frame_bytes(self.material_bytes) > FRAME_BYTES || open.units == PAGE_UNITS {
            self.close()?;
        }
        if self.next >= PAGES {
            return Err(too_many_pages());
        }
        self.open.units.push(nodes.len() as u8);
        self.open.nodes.extend(nodes);
        self.open.links.extend(links);
        for leaf in begin.leaves..begin.leaves + leaves {
            self.open.bitmaps.push(from.bitmap(leaf));
            self.open.normals.push(from.normal(leaf));
            self.open.materials.push(from.material(leaf));
        }
        *begin = UnitCounts {
            units: begin.units + 1,
            nodes: begin.nodes + nodes.len(),
            leaves: begin.leaves + leaves,
            links: 0,
        };
        Ok(UnitRef::new(self.next, self.open.units.len() - 1))
    }

    /// Ends the open page.
    fn close(&mut self) -> Result<()> {
        if self.open.units.is_empty() {
            return Ok(());
        }
        (self.put)(self.open.encode(self.material_bytes))?;
        self.open.clear();
        self.next += 1;
        Ok(())
    }
}

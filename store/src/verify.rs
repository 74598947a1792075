//! Verify: reads a page file as far as it was asked to, checks hashes and structure, names what is damaged and where it
//! lies in the model.
//!
//! ```text
//! Quick     superblocks, tables: hashes, ranges, references; heads of the octree's sections        (reads a percent)
//! Hashes    and every byte against its hash                                                        (no decoding)
//! Deep      and every page decoded, the octree and its units against each other
//! ```
//!
//! Invariants: 1. damage is an answer, not an error; 2. memory does not grow with the file but for its tables, in
//! `Deep` for its octree too: the list of damage is bounded, its counts are not; 3. a level finds what those before it
//! find.

mod pace;
mod tables;
mod voxels;

use crate::budget::Budget;
use crate::cluster::{FrameView, TopRef};
use crate::error::{Code, Result};
use crate::file::{
    PageFile, check_lengths, lower_size, read_superblock, section_bytes, table_bytes, upper_size,
};
use crate::geom::Aabb;
use crate::io::{Origin, StagingBuffer};
use crate::layout::{FRAME_BYTES, PageEntry, PageKind, SUPERBLOCK_BYTES};
use pace::Pace;
use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroU64;
use std::path::Path;

/// Most entries of the list of damage.
const DAMAGE_LISTED: usize = 1000;

/// Pages between two reports.
const TELL_PAGES: u32 = 64;

/// How far a file is looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Its structure: superblocks, tables, ranges. No page is read.
    Quick,
    /// And all hashes: every byte.
    #[default]
    Hashes,
    /// And what is decoded from it, and that its parts agree.
    Deep,
}

/// What [`check`] does.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// How far it goes.
    pub level: Level,
    /// Most bytes that are read in a second; `None` for as fast as it goes.
    pub bytes_per_s: Option<NonZeroU64>,
}

/// Something that is not as it was published.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Damage {
    /// In words.
    pub what: String,
    /// The page, where it is one.
    pub page: Option<u32>,
    /// What the page holds.
    pub kind: Option<PageKind>,
    /// Byte offset in the file.
    pub offset: u64,
    /// Length of the damaged stretch.
    pub bytes: u64,
    /// Where what the page holds lies in the model. Of a page of units known to [`Level::Deep`] only.
    pub bounds: Option<Aabb>,
    /// Triangles in the page, none of which will be drawn.
    pub triangle_count: Option<u64>,
}

impl std::fmt::Display for Damage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.what)?;
        if let Some(page) = self.page {
            write!(f, ", page {page}")?;
        }
        if self.kind == Some(PageKind::Units) {
            write!(f, " (voxels)")?;
        }
        if self.kind == Some(PageKind::Colours) {
            write!(f, " (colours)")?;
        }
        if self.kind == Some(PageKind::Normals) {
            write!(f, " (normals)")?;
        }
        write!(f, ", bytes {}..{}", self.offset, self.offset + self.bytes)?;
        if let Some(b) = &self.bounds {
            write!(f, ", box {:?} to {:?}", b.lo, b.hi)?;
        }
        if let Some(count) = self.triangle_count.filter(|&count| count > 0) {
            write!(f, ", {count} triangles")?;
        }
        Ok(())
    }
}

/// The answer.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Verdict {
    /// How far the file was looked at.
    pub level: Level,
    /// Pages read.
    pub page_count: u64,
    /// Triangles in pages that were read and are whole.
    pub triangle_count: u64,
    /// Bytes of the file that were looked at.
    pub bytes_read: u64,
    /// How many damages there are.
    pub damage_count: u64,
    /// Triangles in all damaged pages.
    pub damaged_triangle_count: u64,
    /// The first thousand of them.
    pub damage: Vec<Damage>,
}

/// Checks the file. `report(done, total)` in bytes; its error ends the check.
///
/// # Errors
/// When there is no trex file to check ([`Code::InputFormat`], [`Code::InputUnreadable`], [`Code::Version`]),
/// and [`Code::Io`], [`Code::MemoryLimit`].
pub fn check(
    path: &Path,
    options: &Options,
    budget: &Budget,
    report: &dyn Fn(u64, u64) -> Result<()>,
) -> Result<Verdict> {
    let (pages, octree) = match options.level {
        Level::Quick => (PageCheck::Unread, Octree::Head),
        Level::Hashes => (PageCheck::Hashed, Octree::Hashed),
        Level::Deep => (PageCheck::Decoded, Octree::Parsed),
    };
    let pace = Pace::new(report, options.bytes_per_s);
    Check { pages, octree, pace, verdict: Verdict { level: options.level, ..Verdict::default() } }
        .run(path, budget)
}

/// The check of a file that was written a moment ago: pages are decoded, and of voxels the bytes are compared with
/// their hash, piece by piece, so that no limit under which they could be written is too small.
pub(crate) fn read_back(
    path: &Path,
    budget: &Budget,
    report: &dyn Fn(u64, u64) -> Result<()>,
) -> Result<Verdict> {
    let (pages, octree) = (PageCheck::Decoded, Octree::Hashed);
    Check { pages, octree, pace: Pace::new(report, None), verdict: Verdict::default() }.run(path, budget)
}

/// How pages are checked.
#[derive(Clone, Copy, PartialEq)]
enum PageCheck {
    Unread,
    /// Against their hash.
    Hashed,
    /// And against what the tables say of them, in memory.
    Decoded,
}

/// How the sections of the octree are checked.
#[derive(Clone, Copy, PartialEq)]
enum Octree {
    /// Their heads.
    Head,
    /// Against their hash.
    Hashed,
    /// And against each other, and pages of units against them, in memory.
    Parsed,
}

/// A check under way.
struct Check<'a> {
    pages: PageCheck,
    octree: Octree,
    pace: Pace<'a>,
    verdict: Verdict,
}

impl Check<'_> {
    fn run(mut self, path: &Path, budget: &Budget) -> Result<Verdict> {
        // With the tables and the octree that are leased next, so that a limit too small for all is named at once.
        let frame_bytes = 4 * FRAME_BYTES as u64;
        let tables_bytes = self.tables_bytes(path)?;
        let what = "the tables of the file and a frame";
        let mut lease = budget.lease(what, tables_bytes.saturating_add(frame_bytes))?;
        lease.shrink_to(frame_bytes);
        let file = match PageFile::open(path, budget) {
            Ok(file) => file,
            Err(error) if error.code() == Code::Damaged => {
                tables::check_sections(path, &error, &mut self.verdict)?;
                return Ok(self.verdict);
            }
            Err(error) => return Err(error),
        };
        let block = file.superblock();
        tables::check_superblocks(path, block, &mut self.verdict)?;
        let structure_bytes = 2 * SUPERBLOCK_BYTES as u64 + section_bytes(block);
        self.pace.total = if self.pages == PageCheck::Unread { structure_bytes } else { block.file_bytes };
        self.pace.read(structure_bytes)?;
        if self.pages != PageCheck::Unread {
            self.check_pages(&file)?;
        }
        match self.octree {
            Octree::Head => voxels::check_heads(&file, &mut self.verdict)?,
            Octree::Hashed => voxels::check_bytes(&file, &mut self.pace, &mut self.verdict)?,
            Octree::Parsed => voxels::check(&file, budget, &mut self.pace, &mut self.verdict)?,
        }
        self.verdict.bytes_read = self.pace.total;
        self.pace.finish()?;
        Ok(self.verdict)
    }

    /// Bytes of the tables while they are read, and of the octree where it is read, by what their heads say.
    fn tables_bytes(&self, path: &Path) -> Result<u64> {
        let opened = Origin::open(path)?;
        // What is wrong with them is told when the file is opened.
        let Ok(block) = read_superblock(&opened, path) else { return Ok(0) };
        if check_lengths(&block, path).is_err() {
            return Ok(0);
        }
        let mut bytes = table_bytes(&block);
        if self.octree == Octree::Parsed {
            let upper = upper_size(&opened, &block, path).ok().flatten();
            let lower = lower_size(&opened, &block, path).ok().flatten();
            let sizes = [
                upper.map(|size| [size.resident_bytes, size.reading_bytes]),
                lower.map(|size| [size.resident_bytes, size.reading_bytes]),
            ];
            bytes = sizes.into_iter().flatten().flatten().fold(bytes, u64::saturating_add);
        }
        Ok(bytes)
    }

    fn check_pages(&mut self, file: &PageFile) -> Result<()> {
        let mut boxes = None;
        let (mut frame, mut buffers) = (StagingBuffer::new(FRAME_BYTES)?, [Vec::new(), Vec::new()]);
        for (page, entry) in (0..).zip(file.pages()) {
            file.fetch_run(page);
            let result = match self.pages {
                PageCheck::Decoded => file.read_page(page, &mut frame, &mut buffers),
                _ => file.check_page(page, &mut buffers[0]),
            };
            let is_decoded = self.pages == PageCheck::Decoded && entry.kind == PageKind::Mesh;
            match result {
                Ok(())
                    if is_decoded
                        && FrameView::new(&frame[..]).triangle_count() != entry.triangle_count as usize =>
                {
                    self.verdict.add_page(file, page, "a page holds another count of triangles", &mut boxes);
                }
                Ok(()) => self.verdict.triangle_count += u64::from(entry.triangle_count),
                Err(error) if error.code() == Code::Damaged => {
                    self.verdict.add_page(file, page, error.what(), &mut boxes);
                }
                Err(error) => return Err(error),
            }
            self.verdict.page_count += 1;
            self.pace.read(u64::from(entry.stored_bytes))?;
            if page % TELL_PAGES == 0 {
                self.pace.report_progress()?;
            }
        }
        Ok(())
    }
}

impl Damage {
    /// A stretch of the file that is no page.
    fn of_bytes(what: &str, offset: u64, bytes: u64) -> Damage {
        let what = what.to_owned();
        Damage { what, page: None, kind: None, offset, bytes, bounds: None, triangle_count: None }
    }

    /// A page, whose box is not known yet.
    fn of_page(what: &str, page: u32, entry: &PageEntry) -> Damage {
        Damage {
            page: Some(page),
            kind: Some(entry.kind),
            triangle_count: Some(u64::from(entry.triangle_count)),
            ..Damage::of_bytes(what, entry.offset, u64::from(entry.stored_bytes))
        }
    }
}

impl Verdict {
    fn add(&mut self, damage: Damage) {
        self.damage_count += 1;
        self.damaged_triangle_count += damage.triangle_count.unwrap_or(0);
        if self.damage.len() < DAMAGE_LISTED {
            self.damage.push(damage);
        }
    }

    fn add_page(&mut self, file: &PageFile, page: u32, what: &str, boxes: &mut Option<Vec<Aabb>>) {
        let entry = &file.pages()[page as usize];
        let boxes = boxes.get_or_insert_with(|| page_boxes(file));
        let bounds = boxes.get(page as usize).copied().filter(|bounds| !bounds.is_empty());
        self.add(Damage { bounds, ..Damage::of_page(what, page, entry) });
    }
}

/// Box of each page before those of units, from the top tree (8-bit boxes: a little larger than the triangles); that of
/// a page of colours or normals is empty.
pub fn page_boxes(file: &PageFile) -> Vec<Aabb> {
    let count = file.pages().partition_point(|entry| entry.kind != PageKind::Units);
    let mut boxes = vec![Aabb::EMPTY; count];
    each_child_box(file, |page, child| boxes[page as usize].join(&child));
    boxes
}

/// Boxes of some pages, as [`page_boxes`] has them; pages of units are not among them.
pub fn boxes_of(file: &PageFile, pages: &BTreeSet<u32>) -> BTreeMap<u32, Aabb> {
    let mut boxes = BTreeMap::new();
    each_child_box(file, |page, child| {
        if pages.contains(&page) {
            boxes.entry(page).or_insert(Aabb::EMPTY).join(&child);
        }
    });
    boxes
}

/// Gives each box of the top tree that leads to a page of the mesh: one page may have several.
pub(crate) fn each_child_box(file: &PageFile, mut found: impl FnMut(u32, Aabb)) {
    let block = file.superblock();
    if let TopRef::Page { page, .. } = TopRef::from_word(block.root) {
        found(page, block.bounds);
    }
    for node in file.top() {
        for i in 0..usize::from(node.boxes.child_count) {
            if let TopRef::Page { page, .. } = TopRef::from_word(node.child[i]) {
                let child = node.boxes.child_box(i, block.node_shift);
                let (lo, hi) = (block.lattice.position(child.lo), block.lattice.position(child.hi));
                found(page, Aabb { lo, hi });
            }
        }
    }
}

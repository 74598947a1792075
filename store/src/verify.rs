//! Verify: reads every byte of a page file, checks hashes and structure, names what is damaged and where it lies
//! in the model.
//!
//! Invariants: 1. damage is an answer, not an error; 2. memory does not grow with the file: the list of damage
//! is bounded, its count is not.

mod voxels;

use crate::budget::Budget;
use crate::cluster::{FrameView, TopRef};
use crate::error::{Code, Error, Result};
use crate::file::{PageFile, lower_size, open_regular, read_superblock, table_bytes, upper_size};
use crate::geom::Aabb;
use crate::layout::{FRAME_BYTES, PageKind, SUPERBLOCK_BYTES, SectionKind, Superblock, section_hash};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Most entries of the list of damage.
const DAMAGE_LISTED: usize = 1000;

/// Something that is not as it was published.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Damage {
    /// In words.
    pub what: String,
    /// The page, where it is one.
    pub page: Option<u32>,
    /// Byte offset in the file.
    pub offset: u64,
    /// Length of the damaged stretch.
    pub bytes: u64,
    /// Where the page's triangles lie in the model.
    pub bounds: Option<Aabb>,
}

impl std::fmt::Display for Damage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.what)?;
        if let Some(page) = self.page {
            write!(f, ", page {page}")?;
        }
        write!(f, ", bytes {}..{}", self.offset, self.offset + self.bytes)?;
        if let Some(b) = &self.bounds {
            write!(f, ", box {:?} to {:?}", b.lo, b.hi)?;
        }
        Ok(())
    }
}

/// The answer.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Verdict {
    /// Pages read.
    pub page_count: u64,
    /// Triangles counted in whole pages.
    pub triangle_count: u64,
    /// Bytes read.
    pub bytes_read: u64,
    /// How many damages there are.
    pub damage_count: u64,
    /// The first thousand of them.
    pub damage: Vec<Damage>,
}

/// Checks the whole file. `report(done, total)` in bytes; its error ends the check.
///
/// # Errors
/// When there is no trex file to check ([`Code::InputFormat`], [`Code::InputUnreadable`], [`Code::Version`]),
/// and [`Code::Io`], [`Code::MemoryLimit`].
pub fn check(path: &Path, budget: &Budget, report: &dyn Fn(u64, u64) -> Result<()>) -> Result<Verdict> {
    check_with(Voxels::Content, path, budget, report)
}

/// The same for a file that was written a moment ago: of voxels the bytes are compared with their hash, piece by
/// piece, so that no limit under which they could be written is too small.
pub(crate) fn read_back(
    path: &Path,
    budget: &Budget,
    report: &dyn Fn(u64, u64) -> Result<()>,
) -> Result<Verdict> {
    check_with(Voxels::Bytes, path, budget, report)
}

/// How voxels are checked.
#[derive(Clone, Copy, PartialEq)]
enum Voxels {
    /// Against their hash.
    Bytes,
    /// And against each other, in memory.
    Content,
}

fn check_with(
    voxels: Voxels,
    path: &Path,
    budget: &Budget,
    report: &dyn Fn(u64, u64) -> Result<()>,
) -> Result<Verdict> {
    let mut verdict = Verdict::default();
    // With the tables and the octree that are leased next, so that a limit too small for all is named at once.
    let frame_bytes = 4 * FRAME_BYTES as u64;
    let opened = open_regular(path)?;
    let tables_bytes = read_superblock(&opened, path).map_or(0, |block| {
        let is_deep = voxels == Voxels::Content;
        let upper = upper_size(&opened, &block, path).ok().flatten().filter(|_| is_deep);
        let lower = lower_size(&opened, &block, path).ok().flatten().filter(|_| is_deep);
        let parts = [
            upper.map_or(0, |size| size.resident_bytes.saturating_add(size.reading_bytes)),
            lower.map_or(0, |size| size.resident_bytes.saturating_add(size.reading_bytes)),
        ];
        parts.into_iter().fold(table_bytes(&block), u64::saturating_add)
    });
    let what = "the tables of the file and a frame";
    let mut lease = budget.lease(what, tables_bytes.saturating_add(frame_bytes))?;
    lease.shrink_to(frame_bytes);
    let file = match PageFile::open(path, budget) {
        Ok(file) => file,
        Err(error) if error.code() == Code::Damaged => {
            check_tables(path, &error, budget, &mut verdict)?;
            return Ok(verdict);
        }
        Err(error) => return Err(error),
    };
    check_superblocks(path, file.superblock(), &mut verdict)?;
    let mut boxes = None;
    let (mut frame, mut buffers) = (vec![0; FRAME_BYTES], [Vec::new(), Vec::new()]);
    let total = file.superblock().file_bytes;
    for (page, entry) in (0..).zip(file.pages()) {
        match file.read_page(page, &mut frame, &mut buffers) {
            Ok(()) if entry.kind == PageKind::Units => {}
            Ok(()) if FrameView::new(&frame).triangle_count() == entry.triangle_count as usize => {
                verdict.triangle_count += u64::from(entry.triangle_count);
            }
            Ok(()) => verdict.add_page(&file, page, "a page holds another count of triangles", &mut boxes),
            Err(error) if error.code() == Code::Damaged => {
                verdict.add_page(&file, page, error.what(), &mut boxes);
            }
            Err(error) => return Err(error),
        }
        verdict.page_count += 1;
        verdict.bytes_read += u64::from(entry.stored_bytes);
        if page % 64 == 0 {
            report(verdict.bytes_read, total)?;
        }
    }
    match voxels {
        Voxels::Bytes => voxels::check_bytes(&file, &mut verdict)?,
        Voxels::Content => voxels::check(&file, budget, &mut verdict)?,
    }
    verdict.bytes_read = total;
    report(total, total)?;
    Ok(verdict)
}

impl Verdict {
    fn add(&mut self, damage: Damage) {
        self.damage_count += 1;
        if self.damage.len() < DAMAGE_LISTED {
            self.damage.push(damage);
        }
    }

    fn add_page(&mut self, file: &PageFile, page: u32, what: &str, boxes: &mut Option<Vec<Aabb>>) {
        let entry = &file.pages()[page as usize];
        let boxes = boxes.get_or_insert_with(|| page_boxes(file));
        self.add(Damage {
            what: what.to_string(),
            page: Some(page),
            offset: entry.offset,
            bytes: u64::from(entry.stored_bytes),
            bounds: boxes.get(page as usize).copied(),
        });
    }
}

/// Box of each page of the mesh, from the top tree (8-bit boxes: a little larger than the triangles).
pub fn page_boxes(file: &PageFile) -> Vec<Aabb> {
    let block = file.superblock();
    let mesh_count = file.pages().partition_point(|entry| entry.kind == PageKind::Mesh);
    let mut boxes = vec![Aabb::EMPTY; mesh_count];
    if let TopRef::Page { page, .. } = TopRef::from_word(block.root) {
        boxes[page as usize] = block.bounds;
    }
    for node in file.top() {
        for i in 0..usize::from(node.child_count) {
            if let TopRef::Page { page, .. } = TopRef::from_word(node.child[i]) {
                let child = node.child_box(i, block.node_shift);
                let (lo, hi) = (block.lattice.position(child.lo), block.lattice.position(child.hi));
                boxes[page as usize].join(&Aabb { lo, hi });
            }
        }
    }
    boxes
}

/// Head and tail must both be whole and the same.
fn check_superblocks(path: &Path, block: &Superblock, verdict: &mut Verdict) -> Result<()> {
    let file = open_regular(path)?;
    for (what, offset) in
        [("the head is damaged", 0), ("the tail is damaged", block.file_bytes - SUPERBLOCK_BYTES as u64)]
    {
        let mut bytes = [0; SUPERBLOCK_BYTES];
        file.read_exact_at(&mut bytes, offset).map_err(|e| Error::io("read", path, &e))?;
        if bytes != block.to_bytes() {
            let bytes = SUPERBLOCK_BYTES as u64;
            verdict.add(Damage { what: what.into(), page: None, offset, bytes, bounds: None });
        }
    }
    Ok(())
}

/// What is damaged in a file that cannot be opened for `error`: sections that do not match their hashes, or, where
/// no superblock tells of sections, the file.
fn check_tables(path: &Path, error: &Error, budget: &Budget, verdict: &mut Verdict) -> Result<()> {
    let file = open_regular(path)?;
    if let Ok(block) = read_superblock(&file, path) {
        check_superblocks(path, &block, verdict)?;
        for section in block.sections.iter().filter(|section| section.kind != 0) {
            let _lease = budget.lease("a section of the file", section.bytes)?;
            let mut bytes = vec![0; section.bytes as usize];
            file.read_exact_at(&mut bytes, section.offset).map_err(|e| Error::io("read", path, &e))?;
            if section_hash(&bytes, block.file_id, section.kind) != section.hash {
                let kind = SectionKind::from_word(section.kind);
                let name = kind.map_or("unknown", SectionKind::name);
                let what = format!("the section `{name}` does not match its hash");
                let (offset, bytes) = (section.offset, section.bytes);
                verdict.add(Damage { what, page: None, offset, bytes, bounds: None });
            }
        }
    }
    if verdict.damage_count == 0 {
        let bytes = file.metadata().map_err(|e| Error::io("open", path, &e))?.len();
        verdict.add(Damage { what: summary(error), page: None, offset: 0, bytes, bounds: None });
    }
    Ok(())
}

fn summary(error: &Error) -> String {
    format!("{} ({})", error.what(), error.numbers_text())
}

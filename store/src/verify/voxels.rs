//! Verify, the voxels: the upper octree, the links, and that every unit is what the leaves above it say.
//!
//! ```text
//! per linking node, in the order of words:   nodes of its unit   = its leaves
//!     per leaf:                              leaves of its node  = bits of its bitmap  (and so on, in nested units)
//! ```
//!
//! Invariants: 1. each page of units is read once more, as long as words ascend along the curve, as `build` writes
//! them; 2. a damaged page is named with the box of the linking nodes that lead to it.

use super::{Damage, Pace, Verdict};
use crate::budget::Budget;
use crate::error::{Code, Error, Result};
use crate::file::PageFile;
use crate::geom::Aabb;
use crate::io::StagingBuffer;
use crate::layout::{FRAME_BYTES, Section, SectionKind};
use crate::octree::{NODE_SIDE, Refinement, UnitNode, UnitRef, UnitsView, UpperOctree};

/// Checks all that stands in sections 5 and 6 and in pages of units.
pub(super) fn check(
    file: &PageFile,
    budget: &Budget,
    pace: &mut Pace<'_>,
    verdict: &mut Verdict,
) -> Result<()> {
    let section = |kind| file.superblock().find_section(kind).unwrap_or_default();
    let (upper, _lease) = match file.upper(budget) {
        Ok(None) => return Ok(()),
        Ok(Some(upper)) => upper,
        Err(error) => return verdict.add_section(&error, section(SectionKind::Upper)),
    };
    pace.read(section(SectionKind::Upper).bytes)?;
    let (links, _lease) = match file.lower(&upper, budget) {
        Ok(None) => return Ok(()),
        Ok(Some(links)) => links,
        Err(error) => return verdict.add_section(&error, section(SectionKind::Lower)),
    };
    pace.read(section(SectionKind::Lower).bytes)?;
    let work_bytes = links.count() * (size_of::<(UnitRef, u32)>() + size_of::<[u32; 3]>());
    let _lease = budget.lease("the check of units", (work_bytes + 6 * FRAME_BYTES) as u64)?;
    let places = last_places(&upper);
    let mut order: Vec<(UnitRef, u32)> =
        (0..links.count()).map(|number| (links.unit(number), number as u32)).collect();
    order.sort_unstable();
    let (refinement, outer, inner) = (links.refinement(), CachedPage::new()?, CachedPage::new()?);
    let mut check = UnitCheck { file, verdict, pace, refinement, outer, inner, leaf_count: 0 };
    for (unit, number) in order {
        let bounds = bounds_of(file, &upper, places[number as usize]);
        let node = &upper.last_nodes()[number as usize];
        let bitmap = |rank: u32| upper.bitmaps()[(node.first + rank) as usize];
        check.unit(unit, (node.bits().count_ones(), &bitmap), &bounds)?;
    }
    let counted = check.leaf_count;
    let said = file.lower_size()?.map_or(0, |size| size.leaf_count);
    if verdict.damage_count == 0 && counted != said {
        let error =
            Error::new(Code::Damaged, format!("units hold {counted} leaves, their section says {said}"));
        verdict.add_section(&error, section(SectionKind::Lower))?;
    }
    Ok(())
}

/// Checks the hashes of sections 5 and 6.
pub(super) fn check_bytes(file: &PageFile, pace: &mut Pace<'_>, verdict: &mut Verdict) -> Result<()> {
    for kind in [SectionKind::Upper, SectionKind::Lower] {
        let Some(section) = file.superblock().find_section(kind) else { continue };
        // A section has as many pieces as pages would be; the caller is asked at each.
        let mut on_read = |bytes| {
            pace.read(bytes)?;
            pace.report_progress()
        };
        if let Err(error) = file.check_section(section, kind, &mut on_read) {
            verdict.add_section(&error, section)?;
        }
    }
    Ok(())
}

/// Checks what the heads of sections 5 and 6 say of themselves.
pub(super) fn check_heads(file: &PageFile, verdict: &mut Verdict) -> Result<()> {
    let sizes = [
        (SectionKind::Upper, file.upper_size().map(drop)),
        (SectionKind::Lower, file.lower_size().map(drop)),
    ];
    for (kind, size) in sizes {
        if let (Err(error), Some(section)) = (size, file.superblock().find_section(kind)) {
            verdict.add_section(&error, section)?;
        }
    }
    Ok(())
}

/// Places of the last nodes in their order, each in units of its own side.
fn last_places(upper: &UpperOctree) -> Vec<[u32; 3]> {
    let mut level = vec![[0; 3]];
    let mut nodes = upper.nodes().iter();
    for _ in 1..upper.grid().depth() {
        let mut below = Vec::new();
        for at in level {
            let bits = nodes.next().expect("a node for each child").bits();
            let step = |place: u32| [place & 3, place >> 2 & 3, place >> 4];
            let child = |place| std::array::from_fn(|a| NODE_SIDE * at[a] + step(place)[a]);
            below.extend((0..64).filter(|place| bits >> place & 1 == 1).map(child));
        }
        level = below;
    }
    level
}

/// Box of a last node, model units.
fn bounds_of(file: &PageFile, upper: &UpperOctree, at: [u32; 3]) -> Aabb {
    let side = upper.grid().leaf_steps() * i64::from(NODE_SIDE);
    let lo: [i64; 3] = std::array::from_fn(|a| upper.grid().lo[a] + i64::from(at[a]) * side);
    let lattice = file.superblock().lattice;
    Aabb { lo: lattice.position(lo), hi: lattice.position(lo.map(|q| q + side)) }
}

impl Verdict {
    fn add_section(&mut self, error: &Error, section: Section) -> Result<()> {
        if error.code() != Code::Damaged {
            return Err(error.clone());
        }
        self.add(Damage::of_bytes(error.what(), section.offset, section.bytes));
        Ok(())
    }
}

impl Verdict {
    /// Makes the box of a damaged page hold `bounds`, too.
    fn widen(&mut self, page: u32, bounds: &Aabb) {
        if let Some(damage) = self.damage.iter_mut().find(|damage| damage.page == Some(page)) {
            damage.bounds.get_or_insert(Aabb::EMPTY).join(bounds);
        }
    }

    /// Names a page whose units are not what the octree above them says, once.
    fn add_units(&mut self, file: &PageFile, page: u32, bounds: &Aabb) {
        if !self.damage.iter().any(|damage| damage.page == Some(page)) {
            let entry = &file.pages()[page as usize];
            self.add(Damage::of_page("a unit is not what the leaves above it say", page, entry));
        }
        self.widen(page, bounds);
    }
}

/// A page that was read last.
struct CachedPage {
    page: Option<u32>,
    is_whole: bool,
    bytes: StagingBuffer,
    buffers: [Vec<u8>; 2],
}

struct UnitCheck<'a, 'p> {
    file: &'a PageFile,
    verdict: &'a mut Verdict,
    pace: &'a mut Pace<'p>,
    refinement: Refinement,
    /// The page of the unit at hand, and of the one that nests in it.
    outer: CachedPage,
    inner: CachedPage,
    /// Leaves of all units up to now.
    leaf_count: u64,
}

impl UnitCheck<'_, '_> {
    /// A unit whose linking node has so many leaves with these bitmaps.
    fn unit(
        &mut self,
        unit: UnitRef,
        (leaf_count, bitmap): (u32, &dyn Fn(u32) -> u64),
        bounds: &Aabb,
    ) -> Result<()> {
        if !self.outer.read(self.file, unit.page(), self.pace)? {
            self.verdict.widen(unit.page(), bounds);
            return Ok(());
        }
        let view = UnitsView::new(&self.outer.bytes);
        let mut is_sound = view.node_count(unit.unit()) == leaf_count;
        for rank in 0..leaf_count.min(view.node_count(unit.unit())) {
            let node = view.node(unit.unit(), rank).expect("counted");
            is_sound &= node.leaf_count() == bitmap(rank).count_ones();
            self.leaf_count += u64::from(node.leaf_count());
            match node.link {
                Some(inner) if self.refinement == Refinement::By16 => {
                    if !self.inner.read(self.file, inner.page(), self.pace)? {
                        self.verdict.widen(inner.page(), bounds);
                        continue;
                    }
                    let leaves = nested_leaves(UnitsView::new(&self.inner.bytes), inner, (&view, node));
                    is_sound &= leaves.is_some();
                    self.leaf_count += leaves.unwrap_or(0);
                }
                link => is_sound &= link.is_none() && self.refinement == Refinement::By4,
            }
        }
        if !is_sound {
            self.verdict.add_units(self.file, unit.page(), bounds);
        }
        Ok(())
    }
}

/// Leaves of the unit `inner`, when it is what the leaves of `node` say.
fn nested_leaves(
    page: UnitsView<'_>,
    inner: UnitRef,
    (view, node): (&UnitsView<'_>, UnitNode),
) -> Option<u64> {
    if page.node_count(inner.unit()) != node.leaf_count() {
        return None;
    }
    (0..node.leaf_count()).try_fold(0, |sum, rank| {
        let below = page.node(inner.unit(), rank)?;
        let bits = view.bitmap(node.first_leaf() + rank).count_ones();
        let is_sound = below.leaf_count() == bits && below.link.is_none();
        is_sound.then_some(sum + u64::from(bits))
    })
}

impl CachedPage {
    fn new() -> Result<CachedPage> {
        let (bytes, buffers) = (StagingBuffer::new(FRAME_BYTES)?, [Vec::new(), Vec::new()]);
        Ok(CachedPage { page: None, is_whole: false, bytes, buffers })
    }

    /// Reads a page unless it is there already; false for one that is damaged, which has been told.
    fn read(&mut self, file: &PageFile, page: u32, pace: &mut Pace<'_>) -> Result<bool> {
        if self.page != Some(page) {
            pace.read_again(u64::from(file.pages()[page as usize].stored_bytes))?;
            self.is_whole = match file.read_page(page, &mut self.bytes, &mut self.buffers) {
                Ok(()) => true,
                Err(error) if error.code() == Code::Damaged => false,
                Err(error) => return Err(error),
            };
            self.page = Some(page);
        }
        Ok(self.is_whole)
    }
}

//! `ShardPlan`: what the shards of one build agree on, made once by a scan of the inputs.
//!
//! ```text
//! head | record: facts of the inputs, model, finest level | materials | cells                (`shard_file`)
//! head | runs of triangles | record: which of them make which chunk | record as above        (`planned_triangles`)
//! ```
//!
//! Invariants: 1. it names no machine: inputs stand by their content; 2. a plan that was read can be true, its memory
//! is leased, and every byte of it is under a hash; 3. the hash of the last record is its id, also with triangles.

use super::draft::DraftFile;
use super::journal::record;
use super::options::{BuildOptions, Voxels};
use super::partition::cell_table::{CELL_BYTES, CellRange, CellTable, ShardShare};
use super::partition::cells::{SortKey, SortRule};
use super::partition::chunk::Chunk;
use super::partition::shard::CellCensus;
use super::planned_triangles::PlannedTriangles;
use super::scratch::Scratch;
use super::shard_file::{
    HEAD_BYTES, PlannedModel, ShardFile, ShardFileKind, StoredModel, append_record, blobs,
};
use crate::budget::{Budget, Lease};
use crate::error::{Code, Error, Result};
use crate::next_step::NextStep;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What its tables are called in messages.
const PLAN: &str = "the plan of the shards";
/// Where the head ends.
const HEAD_END: u64 = HEAD_BYTES as u64;

/// What stands before the blobs. Ids are words of 64 bits, which JSON holds.
#[derive(Serialize, Deserialize)]
struct PlanHead {
    facts: Vec<(String, String)>,
    model: StoredModel,
    levels: u32,
}

/// A plan.
pub struct ShardPlan {
    /// Tells it from others: the hash of all that is in it but the triangles, whose own hash is in it.
    id: u64,
    pub(crate) facts: Vec<(String, String)>,
    pub(crate) model: PlannedModel,
    cells: CellTable,
    triangles: Option<PlannedTriangles>,
    _lease: Lease,
}

impl ShardPlan {
    /// Writes the plan of what was counted, of inputs with these facts, behind the triangles that it holds; gives its
    /// id and length.
    pub(super) fn write(
        facts: &[(String, String)],
        model: &PlannedModel,
        census: &CellCensus,
        mut file: DraftFile<'_>,
        options: &BuildOptions,
    ) -> Result<(u64, u64)> {
        let budget = &options.budget;
        // The head's place; it is written last.
        file.append(&[0; HEAD_BYTES])?;
        if let Some((scratch, chunks)) = &census.sorted {
            PlannedTriangles::write((scratch, chunks), &mut file, options)?;
        }
        let mut lease = budget.lease(PLAN, census.cells.len() as u64 * CELL_BYTES)?;
        let (materials, _materials_lease) = model.materials.to_bytes(budget)?;
        lease.grow(PLAN, 2 * materials.len() as u64)?;
        let words = census.cells.words();
        let head = PlanHead { facts: facts.to_vec(), model: model.stored(), levels: census.cells.levels() };
        let id = append_record(&mut file, &head, &[&materials, bytemuck::cast_slice(&words)])?;
        file.write_head(&ShardFileKind::Plan.head())?;
        Ok((id, file.bytes()))
    }

    /// Reads a plan. Its triangles stay where they are.
    ///
    /// # Errors
    /// [`Code::InputFormat`], [`Code::Version`] or [`Code::Damaged`] for what is no whole plan of this version;
    /// [`Code::MemoryLimit`]; those of reading.
    pub fn read(path: &Path, budget: &Budget) -> Result<ShardPlan> {
        let file = ShardFile::open(ShardFileKind::Plan, path)?;
        let not_whole = || file.not_whole();
        let place = file.record_before(file.bytes)?;
        let (before, bytes) = (place.start, place.end - place.start);
        let mut lease = budget.lease(PLAN, bytes.saturating_mul(record::READING))?;
        let (id, record) = file.record::<PlanHead>(place)?;
        let (head, [section, words]) = blobs(record).ok_or_else(not_whole)?;
        let model = PlannedModel::parse(head.model, &section, budget)?.ok_or_else(not_whole)?;
        drop(section);
        let words = bytemuck::allocation::pod_collect_to_vec::<u8, u64>(&words);
        // How much is buffered is not the plan's to say.
        let bits = model.summary.grid.bits;
        let rule = SortRule { by: SortKey::SizeAndPlace, levels: head.levels, bits, buffered_most: 0 };
        let cells = Some(rule).filter(SortRule::is_first).and_then(|rule| CellTable::parse(rule, &words));
        let cells = cells.filter(|cells| cells.triangle_count() == model.summary.triangle_count);
        let cells = cells.ok_or_else(not_whole)?;
        drop(words);
        lease.shrink_to(cells.len() as u64 * CELL_BYTES);
        let triangles = match before {
            HEAD_END => None,
            end => {
                let count = model.summary.triangle_count;
                Some(PlannedTriangles::read((path, &file), file.record_before(end)?, count, budget)?)
            }
        };
        Ok(ShardPlan { id, facts: head.facts, model, cells, triangles, _lease: lease })
    }

    /// Bytes of a plan that are read to memory, at the most: all but its triangles. 0 for what is none.
    pub fn table_bytes(path: &Path) -> u64 {
        let bytes = || -> Result<u64> {
            let file = ShardFile::open(ShardFileKind::Plan, path)?;
            let place = file.record_before(file.bytes)?;
            let first = match place.start {
                HEAD_END => place.start,
                end => file.record_before(end)?.start,
            };
            Ok(file.bytes - first)
        };
        bytes().unwrap_or(0)
    }

    /// Whether it holds the triangles, so that shards need no inputs.
    pub fn has_triangles(&self) -> bool {
        self.triangles.is_some()
    }

    /// The triangles of a share, where the plan holds them.
    ///
    /// # Errors
    /// [`Code::Damaged`] where they cannot be those; those of opening the plan again.
    pub(super) fn triangles(&self, share: ShardShare, path: &Path) -> Result<Option<(Scratch, Vec<Chunk>)>> {
        let Some(triangles) = &self.triangles else { return Ok(None) };
        let range = self.range(share);
        triangles.chunks(range)?.map(Some).ok_or_else(|| {
            let numbers = format!("{} triangles of a shard that are no chunks", range.triangle_count);
            ShardFileKind::Plan.damaged(path, numbers)
        })
    }

    /// Tells it from others.
    pub fn id(&self) -> u64 {
        self.id
    }

    /// Triangles that are built, of all shards together.
    pub fn triangle_count(&self) -> u64 {
        self.model.summary.triangle_count
    }

    /// Triangles of share `index` of `count`, counted from 0.
    pub fn shard_triangle_count(&self, index: u32, count: u32) -> u64 {
        self.range(ShardShare { index, count }).triangle_count
    }

    pub(super) fn range(&self, share: ShardShare) -> CellRange {
        self.cells.range(share)
    }

    pub(super) fn levels(&self) -> u32 {
        self.cells.levels()
    }

    /// The voxel octree that it has chosen, as an option.
    pub(super) fn voxels(&self) -> Voxels {
        match self.model.summary.octree {
            None => Voxels::None,
            Some((upper, refinement)) => Voxels::Refined { upper, refinement },
        }
    }

    /// Refuses inputs that have other facts.
    pub(super) fn check_inputs(&self, facts: &[(String, String)], path: &Path) -> Result<()> {
        let value = |facts: &[(String, String)], name: &str| {
            facts.iter().find(|fact| fact.0 == name).map_or("none".to_owned(), |fact| fact.1.clone())
        };
        let names = self.facts.iter().chain(facts).map(|fact| fact.0.as_str());
        for name in names {
            let (planned, now) = (value(&self.facts, name), value(facts, name));
            if planned != now {
                return Err(Error::new(Code::InputMismatch, "the inputs are not those of the plan")
                    .at(path)
                    .numbers(format!("{name}: {planned} in the plan, {now} now"))
                    .next(NextStep::ScanAgain));
            }
        }
        Ok(())
    }
}

//! `ShardPlan`: what the shards of one build agree on, made once by a scan of the inputs.
//!
//! ```text
//! head (`shard_file`) | record: facts of the inputs, model, finest level | materials | cells
//! ```
//!
//! Invariants: 1. it names no machine: inputs stand by their content; 2. a plan that was read can be true, its memory
//! is leased, and every byte of it is under its hash, which is its id.

use super::draft::Draft;
use super::journal::record;
use super::options::{BuildOptions, Voxels};
use super::partition::cell_table::{CELL_BYTES, CellRange, CellTable, ShardShare};
use super::partition::cells::{SortKey, SortRule};
use super::partition::shard::CellCensus;
use super::shard_file::{HEAD_BYTES, PlannedModel, ShardFileKind, StoredModel, blobs};
use crate::budget::{Budget, Lease};
use crate::error::{Code, Error, Result};
use crate::file::open_regular;
use crate::next_step::NextStep;
use crate::scratch::Place;
use serde::{Deserialize, Serialize};
use std::io::Read;
use std::path::Path;

/// What stands before the blobs. Ids are words of 64 bits, which JSON holds.
#[derive(Serialize, Deserialize)]
struct PlanHead {
    facts: Vec<(String, String)>,
    model: StoredModel,
    levels: u32,
}

/// A plan.
pub struct ShardPlan {
    /// Tells it from others: the hash of all that is in it.
    id: u64,
    pub(crate) facts: Vec<(String, String)>,
    pub(crate) model: PlannedModel,
    cells: CellTable,
    _lease: Lease,
}

impl ShardPlan {
    /// The plan of what was counted, of inputs with these facts, as the bytes of its file.
    pub(super) fn to_bytes(
        facts: &[(String, String)],
        model: &PlannedModel,
        census: &CellCensus,
        budget: &Budget,
    ) -> Result<(Vec<u8>, Lease)> {
        let what = "the plan of the shards";
        let mut lease = budget.lease(what, census.cells.len() as u64 * CELL_BYTES)?;
        let (materials, _materials_lease) = model.materials.to_bytes(budget)?;
        lease.grow(what, 2 * materials.len() as u64)?;
        let words = census.cells.words();
        let head = PlanHead { facts: facts.to_vec(), model: model.stored(), levels: census.cells.levels() };
        let mut bytes = Vec::from(ShardFileKind::Plan.head());
        let blobs: [&[u8]; 2] = [&materials, bytemuck::cast_slice(&words)];
        record::write_to(&mut bytes, &head, &blobs).expect("a vector takes all bytes");
        Ok((bytes, lease))
    }

    /// Publishes the bytes of a plan.
    pub(super) fn publish(bytes: &[u8], output: &Path, folder: &Path, options: &BuildOptions) -> Result<()> {
        let draft = Draft::create(output, folder, Place::Unnamed(folder.to_path_buf()))?;
        draft.file().append(bytes)?;
        draft.publish_unread(output, options)
    }

    /// Reads a plan.
    ///
    /// # Errors
    /// [`Code::InputFormat`], [`Code::Version`] or [`Code::Damaged`] for what is no whole plan of this version;
    /// [`Code::MemoryLimit`]; those of reading.
    pub fn read(path: &Path, budget: &Budget) -> Result<ShardPlan> {
        let kind = ShardFileKind::Plan;
        let failed = |e: std::io::Error| Error::io("read the plan", path, &e);
        let mut file = open_regular(path)?;
        let bytes = file.metadata().map_err(failed)?.len();
        let mut lease = budget.lease("the plan of the shards", bytes.saturating_mul(record::READING))?;
        let mut all = Vec::new();
        Read::by_ref(&mut file).take(bytes).read_to_end(&mut all).map_err(failed)?;
        kind.check(&all, path)?;
        let not_whole = || kind.damaged(path, format!("{bytes} bytes that are no whole plan"));
        let record = record::parse::<PlanHead>(&all[HEAD_BYTES..]).ok_or_else(not_whole)?;
        let id = ShardPlan::id_of(&all);
        drop(all);
        let (head, [section, words]) = blobs(record).ok_or_else(not_whole)?;
        let words = bytemuck::allocation::pod_collect_to_vec::<u8, u64>(&words);
        let model = PlannedModel::parse(head.model, &section, budget)?.ok_or_else(not_whole)?;
        // How much is buffered is not the plan's to say.
        let bits = model.summary.grid.bits;
        let rule = SortRule { by: SortKey::SizeAndPlace, levels: head.levels, bits, buffered_most: 0 };
        let cells = Some(rule).filter(SortRule::is_first).and_then(|rule| CellTable::parse(rule, &words));
        let cells = cells.filter(|cells| cells.triangle_count() == model.summary.triangle_count);
        let cells = cells.ok_or_else(not_whole)?;
        lease.shrink_to(cells.len() as u64 * CELL_BYTES);
        Ok(ShardPlan { id, facts: head.facts, model, cells, _lease: lease })
    }

    /// The id of a plan of these bytes, which are those of a whole one.
    pub(super) fn id_of(bytes: &[u8]) -> u64 {
        u64::from_le_bytes(bytes[HEAD_BYTES..HEAD_BYTES + 8].try_into().expect("eight bytes"))
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

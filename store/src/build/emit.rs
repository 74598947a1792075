//! Emit: workers build chunks, one writer puts their pages into the file in chunk order, then tables and heads.
//!
//! The ends of chunks share pages (`pages.rs`): where one is, is known when its page is full, and told to the nodes then.
//!
//! Invariants: 1. pages stand in chunk order whatever the number of workers; 2. at most [`WINDOW`] finished
//! chunks a worker wait for their turn; 3. every byte written is covered by a hash.

use super::chunk::{Workspace, worker_bytes};
use super::lattice::{Scan, Tell};
use super::pages::{ChunkPages, OpenPage, PackContext, PackedPage, Wide, WideRef, packed};
use super::partition::Partition;
use super::publish::DraftFile;
use super::sah::{Prim, Splitter};
use super::scratch::LatticeTriangle;
use super::voxels::VoxelWork;
use super::{BuildOptions, BuildReport, Voxels};
use crate::cluster::{LatticeBox, Node, TopRef};
use crate::error::Result;
use crate::geom::Aabb;
use crate::layout::*;
use crate::material::Material;
use crate::octree::{Refinement, Voxelizer};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Condvar, Mutex};
use std::time::{Duration, Instant};
use xxhash_rust::xxh3::xxh3_64;

/// Chunks that may be finished ahead of the writer, per worker.
const WINDOW: usize = 3;

/// Writes everything between the two superblocks and the superblocks themselves.
pub(super) fn emit(
    (parted, scan, voxels): (&Partition, &Scan, Option<VoxelWork>),
    materials: &[Material],
    options: &BuildOptions,
    mut file: DraftFile<'_>,
    tell: Tell<'_>,
    out: &mut BuildReport,
) -> Result<Superblock> {
    let workers = worker_count(options).min(parted.chunks.len()).max(1);
    let lease = options.budget.lease("the cluster builders", needed_bytes(options) * workers as u64)?;
    let node_shift = node_shift(parted.grid.bits);
    let emissive: Vec<bool> = materials.iter().map(Material::emits).collect();
    let context = PackContext { emissive: &emissive };
    let materials_json = serde_json::to_vec(materials).expect("materials are plain data");
    let mut writer = Writer {
        file_id: file_id(parted, voxels.as_ref(), &materials_json),
        node_shift,
        block: superblock_of(parted, scan),
        context,
        pages: Vec::new(),
        open: OpenPage::default(),
        links: Vec::new(),
        nodes: Vec::new(),
        roots: Vec::new(),
        emitters: Vec::new(),
        emitter_count: 0,
        scratch_bytes: parted.scratch.bytes(),
    };
    file.append(&[0; SUPERBLOCK_BYTES])?;
    tell("clusters", "triangles", 0, parted.triangle_count);
    in_order(parted, voxels.as_ref(), workers, context, &options.interrupt, |chunk, pages| {
        writer.add_chunk(pages, &mut file)?;
        for piece in &parted.chunks[chunk].pieces {
            parted.scratch.consume(&piece.run, piece.take);
        }
        tell("clusters", "triangles", writer.block.triangle_count, parted.triangle_count);
        Ok(())
    })?;
    writer.close(&mut file)?;
    drop(lease);
    out.scratch_peak_bytes = writer.scratch_bytes;
    let start = Instant::now();
    let merged = match voxels {
        None => None,
        Some(work) => {
            (out.upper_resolution, out.finest_resolution) = (work.grid.resolution, work.finest().resolution);
            let tell = |done| tell("voxels", "records", done, 0);
            let pages = (writer.pages.len() as u32, materials.len());
            let put = &mut |raw| writer.add_units(raw, &mut file);
            Some(work.merge(pages, put, &options.budget, &tell)?)
        }
    };
    writer.write_tables(&mut file, &materials_json, materials.len())?;
    if let Some(merged) = merged {
        out.scratch_peak_bytes = out.scratch_peak_bytes.max(merged.scratch_bytes);
        out.lower_leaf_count = merged.lower_leaf_count();
        let slots = &mut writer.block.sections[SectionKind::ALL.len()..];
        out.upper_leaf_count = merged.write(&mut file, writer.file_id, slots)?;
    }
    out.phase_ms.voxels = start.elapsed().as_millis() as u64;
    writer.seal(&mut file, out)
}

/// What one worker needs.
pub(super) fn needed_bytes(options: &BuildOptions) -> u64 {
    worker_bytes() + if options.voxels == Voxels::None { 0 } else { Voxelizer::BYTES }
}

/// As many workers as there is room for: the result does not depend on it.
pub(super) fn worker_count(options: &BuildOptions) -> usize {
    options.threads.min((options.budget.free_bytes() / needed_bytes(options)) as usize).max(1)
}

/// Builds all chunks on `workers` threads and hands the results to `take`, in order.
fn in_order(
    parted: &Partition,
    voxels: Option<&VoxelWork>,
    workers: usize,
    context: PackContext<'_>,
    interrupt: &crate::Interrupt,
    mut take: impl FnMut(usize, ChunkPages) -> Result<()>,
) -> Result<()> {
    let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
    let written = (Mutex::new(0usize), Condvar::new());
    let window = WINDOW * workers;
    std::thread::scope(|scope| {
        let (sender, results) = sync_channel::<(usize, Result<ChunkPages>)>(workers);
        for worker in 0..workers {
            let (sender, next, stop, written) = (sender.clone(), &next, &stop, &written);
            let work = move || {
                let mut workspace = Workspace::default();
                let mut voxelizer = voxels.map(|work| Voxelizer::new(work.finest(), &work.runs));
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= parted.chunks.len() || stop.load(Ordering::Relaxed) {
                        return;
                    }
                    let mut done = written.0.lock().expect("no panic while held");
                    while index >= *done + window && !stop.load(Ordering::Relaxed) {
                        done = written.1.wait_timeout(done, Duration::from_millis(100)).expect("as above").0;
                    }
                    drop(done);
                    let built = workspace.build(&parted.chunks[index], &parted.scratch, context);
                    let result = built.and_then(|pages| {
                        voxelizer.as_mut().map_or(Ok(()), |v| voxelize(v, index, workspace.triangles()))?;
                        Ok(pages)
                    });
                    if sender.send((index, result)).is_err() {
                        return;
                    }
                }
            };
            let name = format!("trex-build-{worker}");
            std::thread::Builder::new().name(name).spawn_scoped(scope, work).expect("a thread");
        }
        drop(sender);
        let mut waiting = BTreeMap::new();
        let mut turn = 0;
        let outcome = loop {
            if let Err(error) = interrupt.check() {
                break Err(error);
            }
            let (index, result) = match results.recv_timeout(Duration::from_millis(100)) {
                Ok(message) => message,
                Err(RecvTimeoutError::Timeout) => continue,
                Err(RecvTimeoutError::Disconnected) => break Ok(()),
            };
            let taken = result.and_then(|pages| {
                waiting.insert(index, pages);
                while let Some(pages) = waiting.remove(&turn) {
                    take(turn, pages)?;
                    turn += 1;
                    *written.0.lock().expect("no panic while held") = turn;
                    written.1.notify_all();
                }
                Ok(())
            });
            if let Err(error) = taken {
                break Err(error);
            }
        };
        stop.store(true, Ordering::Relaxed);
        written.1.notify_all();
        drop(results);
        outcome
    })
}

/// Makes voxel records of a chunk.
fn voxelize(voxelizer: &mut Voxelizer<'_>, chunk: usize, triangles: &[LatticeTriangle]) -> Result<()> {
    voxelizer.begin(chunk);
    triangles.iter().for_each(|triangle| voxelizer.add(triangle.q, triangle.material));
    voxelizer.finish()
}

/// The file id: what was read and what was asked.
fn file_id(parted: &Partition, voxels: Option<&VoxelWork>, materials_json: &[u8]) -> u64 {
    let mut bytes = Vec::from(materials_json);
    bytes.extend(parted.content_hash.to_le_bytes());
    bytes.extend(parted.grid.lattice.exponent.to_le_bytes());
    parted.grid.lattice.origin.iter().for_each(|v| bytes.extend(v.to_bits().to_le_bytes()));
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend(voxels.map_or(0, |work| work.grid.resolution).to_le_bytes());
    if let Some(work) = voxels.filter(|work| work.refinement != Refinement::None) {
        bytes.extend(work.refinement.factor().to_le_bytes());
    }
    xxh3_64(&bytes)
}

fn superblock_of(parted: &Partition, scan: &Scan) -> Superblock {
    Superblock {
        file_bytes: 0,
        file_id: 0,
        lattice: parted.grid.lattice,
        lattice_bits: parted.grid.bits,
        node_shift: node_shift(parted.grid.bits),
        error_bound: parted.error_bound,
        bounds: Aabb { lo: [0.0; 3], hi: [0.0; 3] },
        lattice_bounds: [[i64::MAX; 3], [i64::MIN; 3]],
        median_edge: scan.median_edge,
        input_triangle_count: parted.input_triangle_count,
        triangle_count: 0,
        vertex_count: 0,
        cluster_count: 0,
        wide_cluster_count: 0,
        rejected_degenerate: parted.rejected_degenerate,
        rejected_non_finite: parted.rejected_non_finite,
        resident_bytes: 0,
        page_tree_bytes: 0,
        root: 0,
        sections: [Section::default(); SECTIONS],
    }
}

/// Collects what the tables need while pages go out.
struct Writer<'a> {
    file_id: u64,
    node_shift: u32,
    block: Superblock,
    context: PackContext<'a>,
    pages: Vec<PageEntry>,
    /// The page that the ends of the last chunks share, and what leads into it.
    open: OpenPage,
    links: Vec<(Link, u32)>,
    nodes: Vec<Node>,
    /// Per chunk: its box and where its root is.
    roots: Vec<(LatticeBox, TopRef)>,
    emitters: Vec<u8>,
    emitter_count: u64,
    scratch_bytes: u64,
}

/// Where it is said in which page a subtree is.
enum Link {
    /// This child of this node.
    Child(usize, usize),
    /// The root of this chunk.
    Root(usize),
}

impl Writer<'_> {
    fn add_chunk(&mut self, chunk: ChunkPages, file: &mut DraftFile<'_>) -> Result<()> {
        let (first_page, first_node) = (self.pages.len() as u32, self.nodes.len() as u32);
        let open_page = chunk.pages.len() as u32;
        for page in chunk.pages {
            self.add_page(page, file)?;
        }
        if !self.open.takes(&chunk.open) {
            self.close(file)?;
        }
        let first_slot = self.open.append(chunk.open);
        let links = &mut self.links;
        let mut moved = |r: TopRef, link: Link| match r {
            TopRef::Node(index) => TopRef::Node(first_node + index),
            TopRef::Page { page, slot } if page == open_page => {
                links.push((link, first_slot + slot));
                r
            }
            TopRef::Page { page, slot } => TopRef::Page { page: first_page + page, slot },
        };
        for children in &chunk.nodes {
            let node = self.nodes.len();
            let words =
                children.iter().zip(0..).map(|(&(b, r), i)| (b, moved(r, Link::Child(node, i)).to_word()));
            self.nodes.push(Node::over(&words.collect::<Vec<_>>(), self.node_shift));
        }
        self.roots.push((chunk.root.0, moved(chunk.root.1, Link::Root(self.roots.len()))));
        Ok(())
    }

    /// Ends the open page, if anything is in it.
    fn close(&mut self, file: &mut DraftFile<'_>) -> Result<()> {
        let page = self.pages.len() as u32;
        let full = std::mem::take(&mut self.open);
        if !full.is_empty() {
            self.add_page(full.pack(self.context), file)?;
        }
        for (link, slot) in self.links.drain(..) {
            let there = TopRef::Page { page, slot };
            match link {
                Link::Child(node, i) => self.nodes[node].child[i] = there.to_word(),
                Link::Root(chunk) => self.roots[chunk].1 = there,
            }
        }
        Ok(())
    }

    fn add_page(&mut self, page: PackedPage, file: &mut DraftFile<'_>) -> Result<()> {
        if self.pages.len() >= PAGES as usize {
            return Err(too_many_pages());
        }
        let (id, first_triangle) = (self.pages.len() as u32, self.block.triangle_count as u32);
        let offset = file.append(&page.stored)?;
        self.pages.push(PageEntry {
            offset,
            hash: page_hash(&page.stored, self.file_id, id),
            stored_bytes: page.stored.len() as u32,
            unpacked_bytes: page.unpacked_bytes as u32,
            first_triangle,
            triangle_count: page.triangle_count as u32,
            kind: PageKind::Mesh,
            packing: page.packing,
        });
        for emitter in &page.emitters {
            emitter.corners.as_flattened().iter().for_each(|q| self.emitters.extend(q.to_le_bytes()));
            self.emitters.extend(u32::from(emitter.material).to_le_bytes());
            self.emitters.extend((first_triangle + emitter.triangle).to_le_bytes());
            self.emitter_count += 1;
        }
        let block = &mut self.block;
        block.triangle_count += page.triangle_count as u64;
        block.vertex_count += page.vertex_count as u64;
        block.cluster_count += page.cluster_count as u64;
        block.wide_cluster_count += page.wide_cluster_count as u64;
        block.resident_bytes += page.frame_bytes as u64;
        block.page_tree_bytes += page.tree_bytes as u64;
        Ok(())
    }

    /// Writes a page of units, given in its stored form before packing.
    fn add_units(&mut self, raw: Vec<u8>, file: &mut DraftFile<'_>) -> Result<()> {
        let (id, unpacked_bytes) = (self.pages.len() as u32, raw.len() as u32);
        let (stored, packing) = packed(raw);
        self.pages.push(PageEntry {
            offset: file.append(&stored)?,
            hash: page_hash(&stored, self.file_id, id),
            stored_bytes: stored.len() as u32,
            unpacked_bytes,
            first_triangle: self.block.triangle_count as u32,
            triangle_count: 0,
            kind: PageKind::Units,
            packing,
        });
        Ok(())
    }

    /// Joins the chunks' trees and writes the tables.
    fn write_tables(
        &mut self,
        file: &mut DraftFile<'_>,
        materials_json: &[u8],
        material_count: usize,
    ) -> Result<()> {
        let bounds = self.roots.iter().fold(LatticeBox::EMPTY, |all, (b, _)| all.join(b));
        self.block.root = self.join_roots().to_word();
        self.block.lattice_bounds = [bounds.lo, bounds.hi];
        self.block.bounds =
            Aabb { lo: self.block.lattice.position(bounds.lo), hi: self.block.lattice.position(bounds.hi) };
        let mut table = Vec::with_capacity(self.pages.len() * PAGE_ENTRY_BYTES);
        self.pages.iter().for_each(|entry| entry.write(&mut table));
        let tree: &[u8] = bytemuck::cast_slice(&self.nodes);
        let sections = [
            (SectionKind::PageTable, table.as_slice(), self.pages.len()),
            (SectionKind::TopTree, tree, self.nodes.len()),
            (SectionKind::Materials, materials_json, material_count),
            (SectionKind::Emitters, &self.emitters, self.emitter_count as usize),
        ];
        self.block.file_id = self.file_id;
        for (slot, (kind, bytes, count)) in sections.into_iter().enumerate() {
            let offset = file.append(bytes)?;
            let hash = section_hash(bytes, self.file_id, kind as u32);
            self.block.sections[slot] =
                Section { kind: kind as u32, count: count as u32, offset, bytes: bytes.len() as u64, hash };
        }
        Ok(())
    }

    /// Writes both superblocks.
    fn seal(mut self, file: &mut DraftFile<'_>, out: &mut BuildReport) -> Result<Superblock> {
        self.block.file_bytes = file.bytes() + SUPERBLOCK_BYTES as u64;
        let head = self.block.to_bytes();
        file.append(&head)?;
        file.write_head(&head)?;
        let block = &self.block;
        out.input_triangle_count = block.input_triangle_count;
        out.triangle_count = block.triangle_count;
        out.rejected_degenerate = block.rejected_degenerate;
        out.rejected_non_finite = block.rejected_non_finite;
        out.cluster_count = block.cluster_count;
        out.wide_cluster_count = block.wide_cluster_count;
        out.page_count = self.pages.len() as u32;
        out.emitter_count = self.emitter_count;
        out.output_bytes = block.file_bytes;
        out.file_id = format!("{:016x}", self.file_id);
        out.cluster_fill =
            block.triangle_count as f64 / (block.cluster_count.max(1) * CLUSTER_TRIANGLES as u64) as f64;
        out.error_bound = block.error_bound;
        Ok(self.block)
    }

    /// The tree above the chunks: SAH again, collapsed to 8-wide nodes. Gives the root of all.
    fn join_roots(&mut self) -> TopRef {
        let all = self.roots.iter().fold(LatticeBox::EMPTY, |all, (b, _)| all.join(b));
        let mut prims: Vec<_> =
            self.roots.iter().enumerate().map(|(i, (b, _))| Prim::of(b, all.lo, i as u32)).collect();
        let mut tree = Vec::new();
        grow(&mut Splitter::default(), &mut prims, &self.roots, &mut tree);
        let wide = Wide::over(&tree);
        let first = self.nodes.len() as u32;
        let word = |r: WideRef, roots: &[(LatticeBox, TopRef)]| match r {
            WideRef::Leaf(i) => roots[i as usize].1,
            WideRef::Node(i) => TopRef::Node(first + i),
        };
        for children in &wide.nodes {
            let children: Vec<_> =
                children.iter().map(|&(b, r)| (b, word(r, &self.roots).to_word())).collect();
            self.nodes.push(Node::over(&children, self.node_shift));
        }
        word(wide.root, &self.roots)
    }
}

/// The binary tree over chunk roots.
fn grow(
    splitter: &mut Splitter,
    prims: &mut [Prim],
    roots: &[(LatticeBox, TopRef)],
    tree: &mut Vec<(LatticeBox, super::chunk::Tree)>,
) -> u32 {
    use super::chunk::Tree;
    if let [only] = prims {
        tree.push((roots[only.index as usize].0, Tree::Cluster(only.index)));
    } else {
        let cut = splitter.split(prims, 1);
        let (left, right) = prims.split_at_mut(cut);
        let left = grow(splitter, left, roots, tree);
        let right = grow(splitter, right, roots, tree);
        tree.push((tree[left as usize].0.join(&tree[right as usize].0), Tree::Split(left, right)));
    }
    tree.len() as u32 - 1
}

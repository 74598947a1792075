//! `PageWriter`: puts pages into the file as they come, keeps what the tables need, and writes tables and superblocks.
//!
//! Invariants: 1. a page that chunks share is written when it is full, and its number enters the roots in it then;
//! 2. every byte is hashed before it is written.

use super::table_bytes::TOP_BYTES;
use crate::budget::{Budget, Lease};
use crate::build::clusters::clusterer::BinaryNode;
use crate::build::clusters::open_page::OpenPage;
use crate::build::clusters::packed_page::{
    AttributePacker, PackContext, PackedAttributes, PackedPage, packed,
};
use crate::build::clusters::pages::{ChunkPages, WideRef, WideTree};
use crate::build::clusters::sah::{Prim, Rule, Splitter};
use crate::build::draft::DraftFile;
use crate::build::model_materials::ModelMaterials;
use crate::build::report::BuildReport;
use crate::cluster::{LatticeBox, Node, TopRef};
use crate::error::Result;
use crate::geom::Aabb;
use crate::layout::*;

/// Collects what the tables need while pages go out.
pub(crate) struct PageWriter<'a> {
    file_id: u64,
    node_shift: u32,
    pub(crate) block: Superblock,
    context: PackContext<'a>,
    pub(crate) pages: Vec<PageEntry>,
    /// The page that the ends of the last chunks share, the first of `roots` in it, and whose ends these are.
    open: OpenPage,
    open_root: usize,
    pub(crate) open_chunks: Vec<usize>,
    /// Roots of pages, with their boxes.
    roots: Vec<(LatticeBox, TopRef)>,
    pub(crate) emitters: Vec<u8>,
    pub(crate) emitter_count: u64,
    /// Of the lists above.
    lease: Lease,
}

impl<'a> PageWriter<'a> {
    pub(crate) fn new(
        file_id: u64,
        block: Superblock,
        context: PackContext<'a>,
        budget: &Budget,
    ) -> Result<PageWriter<'a>> {
        Ok(PageWriter {
            file_id,
            node_shift: block.node_shift,
            block,
            context,
            pages: Vec::new(),
            open: OpenPage::default(),
            open_root: 0,
            open_chunks: Vec::new(),
            roots: Vec::new(),
            emitters: Vec::new(),
            emitter_count: 0,
            lease: budget.lease(TABLES, 0)?,
        })
    }

    /// Triangles in pages so far.
    pub(crate) fn triangle_count(&self) -> u64 {
        self.block.triangle_count
    }

    /// The id of the file.
    pub(crate) fn file_id(&self) -> u64 {
        self.file_id
    }

    /// Pages so far.
    pub(crate) fn page_count(&self) -> u32 {
        self.pages.len() as u32
    }

    /// The slots for the sections of the octree.
    pub(crate) fn voxel_sections(&mut self) -> &mut [Section] {
        &mut self.block.sections[SectionKind::ALL.len()..]
    }

    /// Roots of the pages that are written, with their boxes.
    pub(crate) fn closed_roots(&self) -> &[(LatticeBox, TopRef)] {
        &self.roots[..self.open_root]
    }

    /// Restores what a build before this has written: the page table, roots, emitters.
    pub(crate) fn restore(
        &mut self,
        pages: Vec<PageEntry>,
        roots: Vec<(LatticeBox, TopRef)>,
        emitters: Vec<u8>,
    ) -> Result<()> {
        let [page, root] = [size_of::<PageEntry>(), size_of::<(LatticeBox, TopRef)>()];
        let bytes = pages.capacity() * page + roots.capacity() * root + emitters.capacity();
        self.lease.grow(TABLES, bytes as u64)?;
        self.open_root = roots.len();
        (self.pages, self.roots, self.emitters) = (pages, roots, emitters);
        Ok(())
    }

    /// Writes the pages of chunk `number`, and begins or fills the one that chunks share.
    pub(crate) fn add_chunk(
        &mut self,
        number: usize,
        mut chunk: ChunkPages,
        file: &mut DraftFile<'_>,
    ) -> Result<()> {
        let (first_page, open_page) = (self.pages.len() as u32, chunk.pages.len() as u32);
        let first_triangle = self.block.triangle_count as u32;
        make_room(&mut self.roots, chunk.roots.len(), &mut self.lease)?;
        for page in std::mem::take(&mut chunk.pages) {
            self.add_page(page, file)?;
        }
        self.add_attributes((first_page, first_triangle), std::mem::take(&mut chunk.attributes), file)?;
        // Those of the open page stand last.
        let closed = chunk.roots.iter().filter(|root| root.page < open_page);
        let entered =
            closed.map(|root| (root.bounds, TopRef::Page { page: first_page + root.page, slot: root.slot }));
        let (before, at) = (self.roots.len(), self.open_root);
        self.roots.splice(at..at, entered);
        self.open_root += self.roots.len() - before;
        if !self.open.takes(&chunk.open) {
            self.close(file)?;
        }
        self.append_end(number, open_page, chunk);
        Ok(())
    }

    /// Appends the end of a chunk, which it calls page `open_page`, to the page that chunks share.
    fn append_end(&mut self, number: usize, open_page: u32, chunk: ChunkPages) {
        let first_slot = self.open.append(chunk.open);
        let opened = chunk.roots.iter().filter(|root| root.page == open_page);
        // The number of the page is entered when it is closed.
        let entered =
            opened.map(|root| (root.bounds, TopRef::Page { page: 0, slot: first_slot + root.slot }));
        self.roots.extend(entered);
        self.open_chunks.push(number);
    }

    /// Appends the end of a chunk again that was added before the build was killed, and whose page was open then.
    pub(crate) fn reopen(&mut self, number: usize, chunk: ChunkPages) -> Result<()> {
        make_room(&mut self.roots, chunk.roots.len(), &mut self.lease)?;
        self.append_end(number, chunk.pages.len() as u32, chunk);
        Ok(())
    }

    /// Ends the open page, if anything is in it.
    pub(crate) fn close(&mut self, file: &mut DraftFile<'_>) -> Result<()> {
        let here = self.pages.len() as u32;
        let full = std::mem::take(&mut self.open);
        if !full.is_empty() {
            let (first_triangle, mut packer) = (self.block.triangle_count as u32, AttributePacker::default());
            full.pack_attributes(&mut packer);
            self.add_page(full.pack(self.context), file)?;
            self.add_attributes((here, first_triangle), packer.finish(), file)?;
        }
        for (_, root) in &mut self.roots[self.open_root..] {
            if let TopRef::Page { page, .. } = root {
                *page = here;
            }
        }
        self.open_root = self.roots.len();
        self.open_chunks.clear();
        Ok(())
    }

    fn add_page(&mut self, page: PackedPage, file: &mut DraftFile<'_>) -> Result<()> {
        if self.pages.len() >= PAGES as usize {
            return Err(too_many_pages());
        }
        let (id, first_triangle) = (self.pages.len() as u32, self.block.triangle_count as u32);
        make_room(&mut self.pages, 1, &mut self.lease)?;
        make_room(&mut self.emitters, page.emitters.len() * EMITTER_BYTES, &mut self.lease)?;
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
            colours_behind: 0,
            normals_behind: 0,
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

    /// Writes the attributes of the last mesh pages, of which this is the first, with its first triangle.
    fn add_attributes(
        &mut self,
        (first_page, first_triangle): (u32, u32),
        attributes: PackedAttributes,
        file: &mut DraftFile<'_>,
    ) -> Result<()> {
        for (kind, values) in attributes {
            let first_values = self.pages.len() as u32;
            for (page, first) in (first_page..).zip(values.first_pages) {
                let behind = first.map_or(0, |first| first_values + first - page);
                self.pages[page as usize].set_values_behind(kind, behind);
            }
            *self.block.page_count_mut(kind) += values.pages.len() as u64;
            for part in values.pages {
                self.add_plain(kind, part.bytes, first_triangle + part.first_triangle, file)?;
            }
        }
        Ok(())
    }

    /// Writes a page of units, given in its stored form before packing.
    pub(crate) fn add_units(&mut self, raw: Vec<u8>, file: &mut DraftFile<'_>) -> Result<()> {
        self.add_plain(PageKind::Units, raw, self.block.triangle_count as u32, file)
    }

    /// Writes a page that holds no triangles, given in its stored form before packing.
    fn add_plain(
        &mut self,
        kind: PageKind,
        raw: Vec<u8>,
        first_triangle: u32,
        file: &mut DraftFile<'_>,
    ) -> Result<()> {
        if self.pages.len() >= PAGES as usize {
            return Err(too_many_pages());
        }
        let (id, unpacked_bytes) = (self.pages.len() as u32, raw.len() as u32);
        let (stored, packing) = packed(raw);
        make_room(&mut self.pages, 1, &mut self.lease)?;
        self.pages.push(PageEntry {
            offset: file.append(&stored)?,
            hash: page_hash(&stored, self.file_id, id),
            stored_bytes: stored.len() as u32,
            unpacked_bytes,
            first_triangle,
            triangle_count: 0,
            kind,
            packing,
            colours_behind: 0,
            normals_behind: 0,
        });
        Ok(())
    }

    /// Makes the top tree and writes the tables.
    pub(crate) fn write_tables(
        &mut self,
        file: &mut DraftFile<'_>,
        materials: &ModelMaterials,
        budget: &Budget,
    ) -> Result<()> {
        let bounds = self.roots.iter().fold(LatticeBox::EMPTY, |all, (b, _)| all.join(b));
        let _lease = budget.lease("the top tree", (self.roots.len() * TOP_BYTES) as u64)?;
        let (nodes, root) = self.top_tree();
        self.block.root = root.to_word();
        self.block.lattice_bounds = [bounds.lo, bounds.hi];
        self.block.bounds =
            Aabb { lo: self.block.lattice.position(bounds.lo), hi: self.block.lattice.position(bounds.hi) };
        let mut table = Vec::with_capacity(self.pages.len() * PAGE_ENTRY_BYTES);
        self.pages.iter().for_each(|entry| entry.write(&mut table));
        let tree: &[u8] = bytemuck::cast_slice(&nodes);
        self.block.file_id = self.file_id;
        let mut write = |kind: SectionKind, count: usize, pieces: &dyn Fn(PutBytes<'_>) -> Result<()>| {
            let (offset, mut hasher) = (file.bytes(), section_hasher(self.file_id, kind as u32));
            pieces(&mut |piece| {
                hasher.update(piece);
                file.append(piece).map(drop)
            })?;
            let (bytes, hash) = (file.bytes() - offset, hasher.digest());
            Ok(Section { kind: kind as u32, count: count as u32, offset, bytes, hash })
        };
        self.block.sections[0] = write(SectionKind::PageTable, self.pages.len(), &|put| put(&table))?;
        self.block.sections[1] = write(SectionKind::TopTree, nodes.len(), &|put| put(tree))?;
        self.block.sections[2] =
            write(SectionKind::Materials, materials.count(), &|put| materials.write(put))?;
        let emitter_count = self.emitter_count as usize;
        self.block.sections[3] = write(SectionKind::Emitters, emitter_count, &|put| put(&self.emitters))?;
        Ok(())
    }

    /// Writes both superblocks.
    pub(crate) fn seal(mut self, file: &mut DraftFile<'_>, out: &mut BuildReport) -> Result<Superblock> {
        self.block.file_bytes = file.bytes() + SUPERBLOCK_BYTES as u64;
        let head = self.block.to_bytes();
        file.append(&head)?;
        file.write_head(&head)?;
        let block = &self.block;
        out.input_triangle_count = block.input_triangle_count;
        out.triangle_count = block.triangle_count;
        out.rejected_degenerate = block.rejected_degenerate;
        out.rejected_collapsed = block.rejected_collapsed;
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

    /// The tree above the roots of all pages: SAH again, collapsed to 8-wide nodes. Gives the root of all.
    fn top_tree(&self) -> (Vec<Node>, TopRef) {
        let roots = &self.roots;
        let all = roots.iter().fold(LatticeBox::EMPTY, |all, (b, _)| all.join(b));
        let mut prims: Vec<_> =
            roots.iter().enumerate().map(|(i, (b, _))| Prim::new(b, all.lo, i as u32)).collect();
        let mut tree = Vec::with_capacity(2 * roots.len());
        grow(&mut Splitter::default(), (&mut prims, 0), roots, &mut tree);
        drop(prims);
        let wide = WideTree::new(&tree);
        let word = |r: WideRef| match r {
            WideRef::Leaf(i) => roots[i as usize].1,
            WideRef::Node(i) => TopRef::Node(i),
        };
        let node = |children: &Vec<(LatticeBox, WideRef)>| {
            let children: Vec<_> = children.iter().map(|&(b, r)| (b, word(r).to_word())).collect();
            Node::from_children(&children, self.node_shift)
        };
        (wide.nodes.iter().map(node).collect(), word(wide.root))
    }
}

/// Takes the pieces of a section.
type PutBytes<'a> = &'a mut dyn FnMut(&[u8]) -> Result<()>;

/// What the lists are called in messages.
const TABLES: &str = "the tables of the file";

/// Makes room for so many items: what a list takes is leased before it grows.
pub(crate) fn make_room<T>(list: &mut Vec<T>, more: usize, lease: &mut Lease) -> Result<()> {
    let (length, before) = (list.len(), list.capacity());
    if before - length < more {
        let after = (length + more).max(2 * before);
        lease.grow(TABLES, (after * size_of::<T>()) as u64)?;
        list.reserve_exact(after - length);
        lease.shrink_to(lease.bytes() - (before * size_of::<T>()) as u64);
    }
    Ok(())
}

/// The binary tree over roots.
fn grow(
    splitter: &mut Splitter,
    (prims, depth): (&mut [Prim], usize),
    roots: &[(LatticeBox, TopRef)],
    tree: &mut Vec<(LatticeBox, BinaryNode)>,
) -> u32 {
    if let [only] = prims {
        tree.push((roots[only.index as usize].0, BinaryNode::Cluster(only.index)));
    } else {
        let cut = splitter.split(prims, Rule { leaf: 1, quantum: 1, depth });
        let (left, right) = prims.split_at_mut(cut);
        let left = grow(splitter, (left, depth + 1), roots, tree);
        let right = grow(splitter, (right, depth + 1), roots, tree);
        tree.push((tree[left as usize].0.join(&tree[right as usize].0), BinaryNode::Split(left, right)));
    }
    tree.len() as u32 - 1
}

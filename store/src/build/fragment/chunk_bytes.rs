//! The pages of a chunk as bytes, and the gate through which they come back.
//!
//! ```text
//! chunk   = pages u32 | page ... | colours | normals | end
//!         | roots u32 | root ...
//! page    = stored, packing, unpacked, tree, frame bytes, triangles, vertices, clusters, wide clusters, emitters: u32
//!         | stored bytes | emitter ...
//! emitter = triangle u32 | material u32 | corners 9 x u64
//! colours = first page u32 of each page (0: none) | pages u32 | (first triangle u32 | bytes u32 | bytes) ...
//! normals = as colours
//! end     = `OpenPage::write`
//! root    = box 6 x u64 | page u32 | slot u32
//! ```
//!
//! Invariant: what was read can be put into a file without a panic: each number is within the bounds of the model. That
//! a stored page holds what its counts say is found when the file is read back.

use crate::build::clusters::open_page::OpenPage;
use crate::build::clusters::packed_page::{PackContext, PackedPage, PageEmitter};
use crate::build::clusters::pages::{ChunkPages, ChunkRoot};
use crate::build::partition::chunk::CHUNK_TRIANGLES;
use crate::cluster::{LatticeBox, PackedValues, ValuePage};
use crate::layout::{FRAME_BYTES, PAGE_ROOTS, Packing, PageKind, STORED_BYTES};

/// Numbers of a page before its bytes.
const PAGE_NUMBERS: usize = 10;
/// Most triangles of a page.
const PAGE_TRIANGLES: u32 = u16::MAX as u32;

/// The kinds of attributes, in their order in a chunk.
const ATTRIBUTES: [PageKind; 2] = [PageKind::Colours, PageKind::Normals];

/// Appends the pages of a chunk.
pub(super) fn write_chunk(chunk: &ChunkPages, out: &mut Vec<u8>) {
    put_u32(out, chunk.pages.len());
    chunk.pages.iter().for_each(|page| write_page(page, out));
    assert!(
        chunk.attributes.iter().map(|(kind, _)| *kind).eq(ATTRIBUTES),
        "attributes of all kinds, in order"
    );
    for (_, values) in &chunk.attributes {
        assert_eq!(values.first_pages.len(), chunk.pages.len(), "attributes are of all pages");
        for first in &values.first_pages {
            put_u32(out, first.map_or(0, |first| first as usize + 1));
        }
        put_u32(out, values.pages.len());
        for page in &values.pages {
            put_u32(out, page.first_triangle as usize);
            put_u32(out, page.bytes.len());
            out.extend(&page.bytes);
        }
    }
    chunk.open.write(out);
    put_u32(out, chunk.roots.len());
    for ChunkRoot { bounds, page, slot } in &chunk.roots {
        bounds.lo.iter().chain(&bounds.hi).for_each(|q| out.extend(q.to_le_bytes()));
        put_u32(out, *page as usize);
        put_u32(out, *slot as usize);
    }
}

fn write_page(page: &PackedPage, out: &mut Vec<u8>) {
    let numbers: [usize; PAGE_NUMBERS] = [
        page.stored.len(),
        page.packing as usize,
        page.unpacked_bytes,
        page.tree_bytes,
        page.frame_bytes,
        page.triangle_count,
        page.vertex_count,
        page.cluster_count,
        page.wide_cluster_count,
        page.emitters.len(),
    ];
    numbers.into_iter().for_each(|number| put_u32(out, number));
    out.extend(&page.stored);
    for emitter in &page.emitters {
        put_u32(out, emitter.triangle as usize);
        put_u32(out, usize::from(emitter.material));
        emitter.corners.as_flattened().iter().for_each(|q| out.extend(q.to_le_bytes()));
    }
}

fn put_u32(out: &mut Vec<u8>, number: usize) {
    out.extend(u32::try_from(number).expect("counts of a chunk are far from 32 bits").to_le_bytes());
}

/// Reads chunks of a model.
#[derive(Clone, Copy)]
pub(crate) struct ChunkBytesReader<'a> {
    pub(crate) context: PackContext<'a>,
    pub(crate) lattice_bits: u32,
}

/// What is left to be read.
struct ChunkCursor<'a>(&'a [u8]);

impl<'a> ChunkCursor<'a> {
    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.take(4)?.try_into().expect("four bytes")))
    }

    /// A count of things of which each takes so many bytes or more, so that no list outgrows the bytes.
    fn count(&mut self, least_bytes: usize) -> Option<usize> {
        let count = self.u32()? as usize;
        (count <= self.0.len() / least_bytes).then_some(count)
    }

    fn point(&mut self) -> Option<[i64; 3]> {
        let words = self.take(24)?.as_chunks::<8>().0;
        Some([0, 1, 2].map(|axis| i64::from_le_bytes(words[axis])))
    }
}

impl ChunkBytesReader<'_> {
    /// The chunk of these bytes, and its triangles; `None` where no builder can have written them.
    pub(crate) fn read(&self, bytes: &[u8]) -> Option<(ChunkPages, u64)> {
        let mut cursor = ChunkCursor(bytes);
        let page_count = cursor.count(4 * PAGE_NUMBERS)?;
        let pages = (0..page_count).map(|_| self.page(&mut cursor)).collect::<Option<Vec<_>>>()?;
        let closed: u64 = pages.iter().map(|page| page.triangle_count as u64).sum();
        let known = self.context.attributes;
        let [colours, normals] = [known.colours, known.normals]
            .map(|is_known| self.values(&mut cursor, (page_count, closed), is_known));
        let attributes = ATTRIBUTES.into_iter().zip([colours?, normals?]).collect();
        let (open, rest) = OpenPage::read(cursor.0, self.lattice_bits, self.context)?;
        cursor.0 = rest;
        let root_count = cursor.count(56)?;
        let roots = (0..root_count).map(|_| self.root(&mut cursor)).collect::<Option<Vec<_>>>()?;
        let is_in_order = roots.is_sorted_by_key(|root| root.page);
        let opened = roots.iter().filter(|root| root.page as usize == page_count);
        // The roots of the end are told by their page, and are all that it has.
        let are_its = opened
            .enumerate()
            .try_fold(0, |count, (slot, root)| (root.slot as usize == slot).then_some(count + 1));
        let triangle_count = closed + open.triangle_count() as u64;
        let is_sound = cursor.0.is_empty()
            && is_in_order
            && roots.last().is_some_and(|root| root.page as usize == page_count)
            && are_its == Some(open.root_count())
            && triangle_count <= CHUNK_TRIANGLES;
        is_sound.then_some((ChunkPages { pages, attributes, open, roots }, triangle_count))
    }

    fn page(&self, cursor: &mut ChunkCursor<'_>) -> Option<PackedPage> {
        let mut numbers = [0; PAGE_NUMBERS];
        for number in &mut numbers {
            *number = cursor.u32()?;
        }
        let [stored, packing, unpacked, tree, frame, triangles, vertices, clusters, wide, emitters] = numbers;
        let packing = [Packing::Raw, Packing::Lz4].into_iter().find(|known| *known as u32 == packing)?;
        let is_sound = stored as usize <= STORED_BYTES
            && [unpacked, tree, frame].iter().all(|&bytes| bytes as usize <= FRAME_BYTES)
            && (1..=PAGE_TRIANGLES).contains(&triangles)
            && vertices <= 3 * triangles
            && (1..=triangles).contains(&clusters)
            && wide <= clusters
            && emitters <= triangles;
        if !is_sound {
            return None;
        }
        let stored = cursor.take(stored as usize)?.to_vec();
        let emitter = |_| {
            let (triangle, material) = (cursor.u32()?, u16::try_from(cursor.u32()?).ok()?);
            let corners = [cursor.point()?, cursor.point()?, cursor.point()?];
            let emits = self.context.emissive.get(usize::from(material)).is_some_and(|&emits| emits);
            let is_inside = corners.iter().all(|&corner| self.holds(&LatticeBox { lo: corner, hi: corner }));
            (triangle < triangles && emits && is_inside).then_some(PageEmitter {
                triangle,
                corners,
                material,
            })
        };
        let emitters = (0..emitters).map(emitter).collect::<Option<Vec<_>>>()?;
        let [unpacked_bytes, tree_bytes, frame_bytes] = [unpacked, tree, frame].map(|bytes| bytes as usize);
        let [triangle_count, vertex_count, cluster_count, wide_cluster_count] =
            [triangles, vertices, clusters, wide].map(|count| count as usize);
        Some(PackedPage {
            stored,
            packing,
            unpacked_bytes,
            tree_bytes,
            frame_bytes,
            triangle_count,
            vertex_count,
            cluster_count,
            wide_cluster_count,
            emitters,
        })
    }

    /// The pages of an attribute of so many pages and triangles; there are none where the model has it not.
    fn values(
        &self,
        cursor: &mut ChunkCursor<'_>,
        (page_count, triangle_count): (usize, u64),
        is_known: bool,
    ) -> Option<PackedValues> {
        let firsts = (0..page_count).map(|_| cursor.u32()).collect::<Option<Vec<_>>>()?;
        let value_page_count = cursor.count(8)?;
        let page = |_| {
            let (first_triangle, length) = (cursor.u32()?, cursor.u32()? as usize);
            let is_sound = u64::from(first_triangle) < triangle_count && length <= FRAME_BYTES;
            let bytes = is_sound.then(|| cursor.take(length))??.to_vec();
            Some(ValuePage { first_triangle, bytes })
        };
        let pages = (0..value_page_count).map(page).collect::<Option<Vec<_>>>()?;
        let is_there = |&first: &u32| first as usize <= value_page_count;
        let is_sound = firsts.iter().all(is_there) && (is_known || pages.is_empty());
        let first_pages = firsts.into_iter().map(|first| first.checked_sub(1)).collect();
        is_sound.then_some(PackedValues { pages, first_pages })
    }

    fn root(&self, cursor: &mut ChunkCursor<'_>) -> Option<ChunkRoot> {
        let bounds = LatticeBox { lo: cursor.point()?, hi: cursor.point()? };
        let (page, slot) = (cursor.u32()?, cursor.u32()?);
        let is_box = (0..3).all(|axis| bounds.lo[axis] <= bounds.hi[axis]);
        let is_sound = is_box && self.holds(&bounds) && (slot as usize) < PAGE_ROOTS;
        is_sound.then_some(ChunkRoot { bounds, page, slot })
    }

    /// Whether a box lies in that of the model.
    fn holds(&self, bounds: &LatticeBox) -> bool {
        bounds.join(&self.context.bounds) == self.context.bounds
    }
}

//! `ColourPacker`: pages of colours, as few as hold those of mesh pages that follow each other.
//!
//! Invariants: 1. both forms of a page fit a frame, and its triangles have numbers of 16 bits; 2. a page ends where a
//! mesh page without colours begins.

use super::ClusterMesh;
use super::bits::BitWriter;
use super::colours::{ClusterColours, DISK_HEAD_BYTES, FRAME_HEAD_BYTES};
use crate::layout::FRAME_BYTES;

/// A page of colours before packing.
#[derive(Debug)]
pub(crate) struct ColourPage {
    /// The first triangle that it is of, from the first one that was packed on.
    pub(crate) first_triangle: u32,
    /// The disk form.
    pub(crate) bytes: Vec<u8>,
}

/// Packs the colours of mesh pages that follow each other into as few pages as hold them: a mesh page has far more
/// bytes in memory than its colours.
#[derive(Default)]
pub(crate) struct ColourPacker {
    packed: PackedColours,
    /// The page under way, and its bytes in both forms at most, but for its head.
    open: Vec<ClusterColours>,
    frame_bytes: usize,
    disk_bytes: usize,
    /// Its first triangle, and the one behind all so far.
    first_triangle: u32,
    triangle_count: u32,
}

/// The colours of mesh pages that follow each other.
#[derive(Debug, Default)]
pub(crate) struct PackedColours {
    pub(crate) pages: Vec<ColourPage>,
    /// Of each mesh page: which of `pages` has its first triangle. `None` where it is white all over.
    pub(crate) first_pages: Vec<Option<u32>>,
}

impl ColourPacker {
    /// Adds the colours of the next mesh page.
    pub(crate) fn add(&mut self, clusters: &[ClusterMesh]) {
        let first_page = if clusters.iter().all(|cluster| cluster.colours.is_empty()) {
            None
        } else {
            let all: Vec<_> = clusters.iter().map(ClusterColours::of).collect();
            let is_white = all.iter().all(ClusterColours::is_white);
            (!is_white).then(|| self.add_clusters(all))
        };
        // Nobody asks for the colours of a white one: the next begins behind it.
        if first_page.is_none() {
            self.close();
            self.triangle_count += clusters.iter().map(|cluster| cluster.triangles.len() as u32).sum::<u32>();
        }
        self.packed.first_pages.push(first_page);
    }

    /// Adds clusters; gives the page that the first of them is in.
    fn add_clusters(&mut self, all: Vec<ClusterColours>) -> u32 {
        let mut first_page = None;
        for colours in all {
            let (frame_bytes, disk_bytes) = (colours.frame_bytes(), colours.disk_bytes_most());
            let triangle_count = self.triangle_count + colours.triangle_count as u32;
            let is_full = FRAME_HEAD_BYTES + self.frame_bytes + frame_bytes > FRAME_BYTES
                || DISK_HEAD_BYTES + self.disk_bytes + disk_bytes > FRAME_BYTES
                || triangle_count - self.first_triangle > u32::from(u16::MAX);
            if is_full {
                self.close();
            }
            if self.open.is_empty() {
                self.first_triangle = self.triangle_count;
            }
            first_page.get_or_insert(self.packed.pages.len() as u32);
            self.frame_bytes += frame_bytes;
            self.disk_bytes += disk_bytes;
            self.triangle_count = triangle_count;
            self.open.push(colours);
        }
        first_page.expect("a page has a cluster")
    }

    /// Ends the page under way, if there is one.
    fn close(&mut self) {
        let clusters = std::mem::take(&mut self.open);
        (self.frame_bytes, self.disk_bytes) = (0, 0);
        if !clusters.is_empty() {
            let mut out = BitWriter::default();
            out.put(clusters.len() as u64, 16);
            clusters.iter().for_each(|cluster| cluster.write(&mut out));
            let (first_triangle, bytes) = (self.first_triangle, out.finish());
            self.packed.pages.push(ColourPage { first_triangle, bytes });
        }
    }

    /// All pages.
    pub(crate) fn finish(mut self) -> PackedColours {
        self.close();
        self.packed
    }
}

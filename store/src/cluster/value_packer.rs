//! `ValuePacker`: pages of colours or of normals, as few as hold those of mesh pages that follow each other.
//!
//! Invariants: 1. both forms of a page fit a frame, and its triangles have numbers of 16 bits; 2. a page ends where a
//! mesh page without values begins.

use super::ClusterMesh;
use super::bits::BitWriter;
use super::corner_value::CornerValue;
use super::value_codec::{ClusterValues, DISK_HEAD_BYTES, FRAME_HEAD_BYTES};
use crate::layout::FRAME_BYTES;

/// A page of values before packing.
#[derive(Debug)]
pub(crate) struct ValuePage {
    /// The first triangle that it is of, from the first one that was packed on.
    pub(crate) first_triangle: u32,
    /// The disk form.
    pub(crate) bytes: Vec<u8>,
}

/// Packs values of mesh pages that follow each other into as few pages as hold them: a mesh page has far more
/// bytes in memory than its values.
pub(crate) struct ValuePacker<V> {
    packed: PackedValues,
    /// The page under way, and its bytes in both forms at most, but for its head.
    open: Vec<ClusterValues<V>>,
    frame_bytes: usize,
    disk_bytes: usize,
    /// Its first triangle, and the one behind all so far.
    first_triangle: u32,
    triangle_count: u32,
}

/// The values of mesh pages that follow each other.
#[derive(Debug, Default)]
pub(crate) struct PackedValues {
    pub(crate) pages: Vec<ValuePage>,
    /// Of each mesh page: which of `pages` has its first triangle. `None` where no corner of it has a value.
    pub(crate) first_pages: Vec<Option<u32>>,
}

impl<V> Default for ValuePacker<V> {
    fn default() -> ValuePacker<V> {
        ValuePacker {
            packed: PackedValues::default(),
            open: Vec::new(),
            frame_bytes: 0,
            disk_bytes: 0,
            first_triangle: 0,
            triangle_count: 0,
        }
    }
}

impl<V: CornerValue> ValuePacker<V> {
    /// Adds the values of the next mesh page, `of` each of its clusters: as many as triangles, or none.
    pub(crate) fn add(&mut self, clusters: &[ClusterMesh], of: impl Fn(&ClusterMesh) -> &[[V; 3]]) {
        let first_page = if clusters.iter().all(|cluster| of(cluster).is_empty()) {
            None
        } else {
            let values = |cluster: &ClusterMesh| {
                ClusterValues::of(&cluster.triangles, cluster.vertices.len(), of(cluster))
            };
            let all: Vec<_> = clusters.iter().map(values).collect();
            let is_none = all.iter().all(ClusterValues::is_none);
            (!is_none).then(|| self.add_clusters(all))
        };
        // Nobody asks for those of a page without any: the next begins behind it.
        if first_page.is_none() {
            self.close();
            self.triangle_count += clusters.iter().map(|cluster| cluster.triangles.len() as u32).sum::<u32>();
        }
        self.packed.first_pages.push(first_page);
    }

    /// Adds clusters; gives the page that the first of them is in.
    fn add_clusters(&mut self, all: Vec<ClusterValues<V>>) -> u32 {
        let mut first_page = None;
        for values in all {
            let (frame_bytes, disk_bytes) = (values.frame_bytes(), values.disk_bytes_most());
            let triangle_count = self.triangle_count + values.triangle_count as u32;
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
            self.open.push(values);
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
            let mut last = V::NONE;
            clusters.iter().for_each(|cluster| cluster.write(&mut last, &mut out));
            let (first_triangle, bytes) = (self.first_triangle, out.finish());
            self.packed.pages.push(ValuePage { first_triangle, bytes });
        }
    }

    /// All pages.
    pub(crate) fn finish(mut self) -> PackedValues {
        self.close();
        self.packed
    }
}

//! `PackedPage`: a page of the mesh as it will stand in the file, with what the tables say of it.

use crate::attributes::AttributeSet;
use crate::cluster::{ClusterMesh, Colour, LatticeBox, Normal, PackedValues, PageContent, ValuePacker};
use crate::layout::{Packing, PageKind};

/// A page ready to be written.
pub(crate) struct PackedPage {
    /// As it will stand on disk.
    pub(crate) stored: Vec<u8>,
    pub(crate) packing: Packing,
    pub(crate) unpacked_bytes: usize,
    pub(crate) tree_bytes: usize,
    pub(crate) frame_bytes: usize,
    pub(crate) triangle_count: usize,
    pub(crate) vertex_count: usize,
    pub(crate) cluster_count: usize,
    pub(crate) wide_cluster_count: usize,
    pub(crate) emitters: Vec<PageEmitter>,
}

/// An emissive triangle of a page.
pub(crate) struct PageEmitter {
    /// Index within the page.
    pub(crate) triangle: u32,
    pub(crate) corners: [[i64; 3]; 3],
    pub(crate) material: u16,
}

/// What the pages of all chunks share.
#[derive(Clone, Copy)]
pub(crate) struct PackContext<'a> {
    /// Per material: does it emit?
    pub(crate) emissive: &'a [bool],
    /// Holds all of them.
    pub(crate) bounds: LatticeBox,
    /// What the corners of any of them have.
    pub(crate) attributes: AttributeSet,
}

/// Packs the attributes of pages that follow each other.
#[derive(Default)]
pub(crate) struct AttributePacker {
    colours: ValuePacker<Colour>,
    normals: ValuePacker<Normal>,
}

/// The attributes of pages that follow each other, by kind.
pub(crate) type PackedAttributes = Vec<(PageKind, PackedValues)>;

impl AttributePacker {
    /// Adds those of the next page.
    pub(super) fn add(&mut self, page: &PageContent) {
        self.colours.add(&page.clusters, |cluster| &cluster.colours);
        self.normals.add(&page.clusters, |cluster| &cluster.normals);
    }

    /// All pages of attributes.
    pub(crate) fn finish(self) -> PackedAttributes {
        vec![(PageKind::Colours, self.colours.finish()), (PageKind::Normals, self.normals.finish())]
    }
}

/// What LZ4 must save, in percent of the raw bytes, to be worth its decode.
const LZ4_GAIN_PERCENT: usize = 3;

impl PackedPage {
    /// Of a content that has a cluster.
    pub(super) fn new(page: &PageContent, context: PackContext<'_>) -> PackedPage {
        assert!(!page.clusters.is_empty(), "a page has a cluster");
        let (raw, spent) = page.encode();
        let unpacked_bytes = raw.len();
        let (stored, packing) = packed(raw);
        PackedPage {
            stored,
            packing,
            unpacked_bytes,
            tree_bytes: spent.tree as usize / 8,
            frame_bytes: page.frame_bytes(),
            triangle_count: page.triangle_count(),
            vertex_count: page.clusters.iter().map(|c| c.vertices.len()).sum(),
            cluster_count: page.clusters.len(),
            wide_cluster_count: page.clusters.iter().filter(|c| c.widths().wide).count(),
            emitters: emitters_of(&page.clusters, context.emissive),
        }
    }
}

/// A page as it is stored.
pub(crate) fn packed(raw: Vec<u8>) -> (Vec<u8>, Packing) {
    let packed = lz4_flex::block::compress(&raw);
    let gains = packed.len() * 100 <= raw.len() * (100 - LZ4_GAIN_PERCENT);
    if gains { (packed, Packing::Lz4) } else { (raw, Packing::Raw) }
}

fn emitters_of(clusters: &[ClusterMesh], emissive: &[bool]) -> Vec<PageEmitter> {
    let materials = clusters.iter().flat_map(|cluster| &cluster.materials);
    let count = materials.filter(|&&material| emissive[usize::from(material)]).count();
    let mut emitters = Vec::with_capacity(count);
    let mut first = 0;
    for cluster in clusters {
        for (i, (corners, &material)) in cluster.triangles.iter().zip(&cluster.materials).enumerate() {
            if emissive.get(usize::from(material)).is_some_and(|&e| e) {
                let corners = corners.map(|index| cluster.vertices[usize::from(index)]);
                emitters.push(PageEmitter { triangle: first + i as u32, corners, material });
            }
        }
        first += cluster.triangles.len() as u32;
    }
    emitters
}

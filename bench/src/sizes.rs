//! Workload `sizes`: what the clusters and pages of a file would take in forms that are not shipped.
//!
//! ```text
//! clusters of a file -> as they are | halves | neighbours in pairs
//!                    -> head, boxes, indices, vertices -> bytes a triangle
//! pages of a file    -> as stored | unpacked
//! ```
//!
//! Invariants: 1. counted, not estimated: vertices of a half or of a pair are numbered anew, in the order of first
//! use, and their leaves are plain; 2. nodes count as what a full one takes
//! for each of its children; 3. what is common to all forms is left out: tables, unused ends of frames.

use crate::model::{Model, Surroundings};
use anyhow::ensure;
use serde::Serialize;
use std::collections::BTreeMap;
use trex_render::AllResident;
use trex_store::PageFile;
use trex_store::cluster::{CLUSTER_HEAD_BYTES, ClusterMesh, FrameView, LEAF_PLANES, Node};
use trex_store::layout::{FRAME_BYTES, LEAF_TRIANGLES, NODE_WIDTH, Packing, PageKind};

/// Bytes of a cluster's head without its leaf boxes, with its place in a node and one material.
const HEAD_BYTES: usize = CLUSTER_HEAD_BYTES + Node::BYTES / NODE_WIDTH + 2;
/// Bytes of a leaf before its indices: box and shape.
const BOX_BYTES: usize = LEAF_PLANES + 1;

/// Bytes per triangle.
#[derive(Clone, Debug, Serialize)]
pub struct SizeFigures {
    /// The model.
    pub scene: String,
    /// Triangles.
    pub triangle_count: u64,
    /// Clusters.
    pub cluster_count: usize,
    /// Share of the mesh's frames that is in use.
    pub frame_fill: f64,
    /// Pages of the mesh that are stored as they are, since LZ4 gains too little.
    pub raw_page_count: usize,
    /// On disk, pages of the mesh: packed where that gains, as shipped; and all of them as they are.
    pub disk: Packed,
    /// In memory.
    pub resident: BTreeMap<&'static str, f64>,
    /// Vertices per triangle in clusters of 64, 128 and 256.
    pub vertices: BTreeMap<&'static str, f64>,
}

/// Pages with and without LZ4.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Packed {
    /// As stored.
    pub lz4: f64,
    /// Unpacked.
    pub raw: f64,
}

/// How the corners of a leaf are kept.
#[derive(Clone, Copy, PartialEq)]
enum Indices {
    /// As wide as the leaf needs: shipped.
    AsNeeded,
    /// 7 bits each.
    Fixed,
}

/// Counts the bytes of `model`.
///
/// # Errors
/// The file cannot be read; its pages do not fit the limit; it holds wide clusters.
pub fn run(model: &Model, around: &Surroundings) -> anyhow::Result<SizeFigures> {
    let file = PageFile::open(&model.path, &around.budget)?;
    let triangle_count = file.superblock().triangle_count;
    let (mut resident, mut vertices) = (BTreeMap::new(), BTreeMap::new());
    let (mut cluster_count, mut frame_count, mut used_bytes) = (0, 0, 0);
    let _pages_lease = around.budget.lease("all pages", (file.pages().len() * FRAME_BYTES) as u64)?;
    let pages = AllResident::load(&file);
    for (page, _) in (0..).zip(file.pages()).filter(|(_, entry)| entry.kind == PageKind::Mesh) {
        let mut clusters = vec![];
        let view = FrameView::new(pages.frame(page));
        (used_bytes, frame_count) = (used_bytes + view.used_bytes(), frame_count + 1);
        view.for_each_cluster(|cluster| {
            clusters.push(cluster.decode());
        });
        ensure!(
            clusters.iter().all(|mesh| !mesh.widths().wide),
            "page {page} holds wide clusters: count another model"
        );
        cluster_count += clusters.len();
        let mut count = |name, vertex_name, meshes: &[ClusterMesh], leaf, indices| {
            let bytes: usize = meshes.iter().map(|mesh| frame_bytes(mesh, leaf, indices)).sum();
            *resident.entry(name).or_insert(0) += bytes;
            if let Some(name) = vertex_name {
                *vertices.entry(name).or_insert(0) +=
                    meshes.iter().map(|mesh| mesh.vertices.len()).sum::<usize>();
            }
        };
        let halves: Vec<_> = clusters.iter().flat_map(halves).collect();
        let pairs: Vec<_> = clusters.chunks(2).flat_map(pair).collect();
        count("cluster_128_leaf_8", Some("cluster_128"), &clusters, 8, Indices::AsNeeded);
        count("cluster_128_leaf_8_corners_21_bits", None, &clusters, 8, Indices::Fixed);
        count("cluster_128_leaf_4", None, &clusters, 4, Indices::AsNeeded);
        count("cluster_64_leaf_8", Some("cluster_64"), &halves, 8, Indices::AsNeeded);
        count("cluster_256_leaf_8", Some("cluster_256"), &pairs, 8, Indices::AsNeeded);
    }
    let mesh = || file.pages().iter().filter(|entry| entry.kind == PageKind::Mesh);
    let per = |bytes: u64| bytes as f64 / triangle_count as f64;
    let all = |counts: BTreeMap<&'static str, usize>| {
        counts.into_iter().map(|(name, count)| (name, per(count as u64))).collect()
    };
    Ok(SizeFigures {
        scene: model.scene.clone(),
        triangle_count,
        cluster_count,
        frame_fill: used_bytes as f64 / (frame_count * FRAME_BYTES) as f64,
        raw_page_count: mesh().filter(|entry| entry.packing == Packing::Raw).count(),
        disk: Packed {
            lz4: per(mesh().map(|entry| u64::from(entry.stored_bytes)).sum()),
            raw: per(mesh().map(|entry| u64::from(entry.unpacked_bytes)).sum()),
        },
        resident: all(resident),
        vertices: all(vertices),
    })
}

/// Bytes of a cluster in memory, of a form with up to `leaf` triangles a leaf: with its own leaves where they are such.
fn frame_bytes(mesh: &ClusterMesh, leaf: usize, indices: Indices) -> usize {
    let has_such = leaf == LEAF_TRIANGLES && !mesh.leaf_sizes.is_empty();
    let leaves: Vec<_> =
        if has_such { mesh.leaves().collect() } else { mesh.triangles.chunks(leaf).collect() };
    let leaves = leaves.into_iter().map(|triangles| {
        let corners = triangles.as_flattened().iter();
        let span = corners.clone().max().expect("a leaf is not empty") - corners.min().expect("as well");
        let width = (8 - span.leading_zeros() as usize).max(1);
        BOX_BYTES
            + match indices {
                Indices::AsNeeded => 1 + 3 * (triangles.len() * width).div_ceil(8),
                Indices::Fixed => (3 * triangles.len() * 7).div_ceil(8),
            }
    });
    let bits = mesh.widths().bits.iter().map(|&bits| usize::from(bits)).sum::<usize>();
    HEAD_BYTES + leaves.sum::<usize>() + (bits * mesh.vertices.len()).div_ceil(8)
}

/// A cluster as two of up to 64 triangles.
fn halves(mesh: &ClusterMesh) -> Vec<ClusterMesh> {
    mesh.triangles
        .chunks(64)
        .map(|part| renumbered(&mesh.vertices, part.iter().map(|t| t.map(usize::from))))
        .collect()
}

/// Two neighbours as one: of twice 128 vertices, which a byte still tells apart.
fn pair(two: &[ClusterMesh]) -> Vec<ClusterMesh> {
    let [a, b] = two else { return two.to_vec() };
    let vertices = [a.vertices.as_slice(), &b.vertices].concat();
    let behind = b.triangles.iter().map(|t| t.map(|v| usize::from(v) + a.vertices.len()));
    let all = a.triangles.iter().map(|t| t.map(usize::from)).chain(behind);
    vec![renumbered(&vertices, all)]
}

/// These triangles, with their vertices in the order of first use, equal ones once.
fn renumbered(vertices: &[[i64; 3]], triangles: impl Iterator<Item = [usize; 3]>) -> ClusterMesh {
    let (mut mesh, mut numbers) = (ClusterMesh::default(), BTreeMap::new());
    for triangle in triangles {
        mesh.triangles.push(triangle.map(|v| {
            let next = mesh.vertices.len();
            let number = *numbers.entry(vertices[v]).or_insert(next);
            if number == next {
                mesh.vertices.push(vertices[v]);
            }
            number as u8
        }));
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of triangles (i, i + 1, i + 2).
    fn strip(triangle_count: usize, from: i64) -> ClusterMesh {
        ClusterMesh {
            vertices: (0..triangle_count as i64 + 2).map(|i| [from + i, 0, 0]).collect(),
            triangles: (0..triangle_count as u8).map(|i| [i, i + 1, i + 2]).collect(),
            leaf_sizes: (0..triangle_count.div_ceil(8))
                .map(|i| (triangle_count - 8 * i).min(8) as u8)
                .collect(),
            materials: vec![0; triangle_count],
        }
    }

    #[test]
    fn halves_and_pairs_share_no_vertex_twice() {
        let whole = strip(100, 0);
        let parts = halves(&whole);
        assert_eq!(parts.iter().map(|part| part.vertices.len()).collect::<Vec<_>>(), [66, 38]);
        // Vertices 100 and 101 belong to both.
        let joined = pair(&[whole.clone(), strip(50, 100)]);
        assert_eq!(joined.iter().map(|part| part.vertices.len()).collect::<Vec<_>>(), [152]);
        assert_eq!(joined[0].triangles[100], [100, 101, 102]);
        assert_eq!(pair(&[strip(100, 0), strip(100, 1000),]).len(), 1);
        assert_eq!(pair(&[strip(120, 0), strip(126, 1000)]).len(), 1 + usize::from(122 + 128 > 256));
    }

    #[test]
    fn bytes_are_those_that_install_makes() {
        for triangle_count in [1, 50, 126] {
            let mesh = strip(triangle_count, 0);
            let in_node = Node::BYTES / NODE_WIDTH;
            assert_eq!(frame_bytes(&mesh, 8, Indices::AsNeeded), mesh.frame_bytes() + in_node);
        }
    }
}

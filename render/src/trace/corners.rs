//! Triangles of a file by their ids: corners and materials, through the pages of a pool.
//!
//! ```text
//! ids in rising order -> groups of a page -> pages asked for a few ahead -> wait -> clusters that hold some -> decoded
//! ```
//!
//! Invariant: at most [`AHEAD`] pages are asked for at a time, and one is needed to go on.

use super::PagedTracer;
use super::pages::{Page, Pages};
use super::pooled::MeshTracer;
use super::retry::WAIT;
use std::ops::Range;
use trex_store::PageFile;
use trex_store::cluster::FrameView;
use trex_store::layout::PageKind;

/// Pages that are asked for together: what disks take at a time.
const AHEAD: usize = 32;

/// A triangle as the file has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshTriangle {
    /// Corners, counter-clockwise seen from the side of the normal; model units. Not numbers where its page is damaged.
    pub corners: [[f64; 3]; 3],
    /// Index into the materials.
    pub material: u32,
}

impl MeshTriangle {
    /// What stands for a triangle of a damaged page.
    pub const LOST: MeshTriangle = MeshTriangle { corners: [[f64::NAN; 3]; 3], material: 0 };
}

/// A page with some of the asked triangles.
struct Group {
    page: u32,
    /// Store id of its first triangle.
    first_triangle: u32,
    /// Which of those that were asked for lie in it.
    asked: Range<usize>,
}

/// Reads the triangles `ids`, which rise, appended to `triangles` in their order. False when `stop` said so before all
/// were read.
///
/// # Panics
/// When an id is not one of the file's.
pub fn read_triangles(
    tracer: &mut MeshTracer,
    file: &PageFile,
    ids: &[u32],
    stop: &dyn Fn() -> bool,
    triangles: &mut Vec<MeshTriangle>,
) -> bool {
    let groups = groups(file, ids);
    for (at, group) in groups.iter().enumerate() {
        tracer.begin_tile();
        loop {
            if stop() {
                return false;
            }
            match tracer.pages_mut().page(group.page) {
                Page::Ready(frame) => break decode(file, FrameView::new(frame), group, ids, triangles),
                Page::Damaged => break triangles.extend(group.asked.clone().map(|_| MeshTriangle::LOST)),
                Page::Missing => {
                    let ahead = groups[at..].iter().take(AHEAD);
                    ahead.for_each(|group| tracer.pages_mut().want(group.page));
                    tracer.request_missing();
                    tracer.wait(WAIT);
                }
            }
        }
    }
    true
}

/// The pages of `ids`, in their order.
fn groups(file: &PageFile, ids: &[u32]) -> Vec<Group> {
    let pages = file.pages();
    let mesh: Vec<u32> =
        (0..pages.len() as u32).filter(|&page| pages[page as usize].kind == PageKind::Mesh).collect();
    let mut groups: Vec<Group> = Vec::new();
    for (place, &id) in ids.iter().enumerate() {
        let before = mesh.partition_point(|&page| pages[page as usize].first_triangle <= id);
        let page = mesh[before.checked_sub(1).expect("the first page has the first triangle")];
        match groups.last_mut() {
            Some(group) if group.page == page => group.asked.end = place + 1,
            _ => {
                let first_triangle = pages[page as usize].first_triangle;
                groups.push(Group { page, first_triangle, asked: place..place + 1 });
            }
        }
    }
    groups
}

/// Appends the triangles of a page that were asked for.
fn decode(
    file: &PageFile,
    frame: FrameView<'_>,
    group: &Group,
    ids: &[u32],
    triangles: &mut Vec<MeshTriangle>,
) {
    let lattice = &file.superblock().lattice;
    let first = triangles.len();
    let asked = &ids[group.asked.clone()];
    triangles.resize(first + asked.len(), MeshTriangle::LOST);
    let mut place = 0;
    while place < asked.len() {
        let Some(cluster) = frame.cluster_with((asked[place] - group.first_triangle) as usize) else {
            place += 1;
            continue;
        };
        let from = group.first_triangle + cluster.first_triangle() as u32;
        let end = asked.partition_point(|&id| id < from + cluster.triangle_count() as u32);
        let mesh = cluster.decode();
        for place in place..end {
            let index = (asked[place] - from) as usize;
            triangles[first + place] = MeshTriangle {
                corners: mesh.triangles[index]
                    .map(|vertex| lattice.position(mesh.vertices[usize::from(vertex)])),
                material: mesh.materials[index].into(),
            };
        }
        place = end;
    }
}

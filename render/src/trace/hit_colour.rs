//! The colour of a hit: of the corners of its triangle, weighed by where the ray met it. Read from a page of its own,
//! once the hit is known: traversal never asks for it.
//!
//! Corners are sRGB bytes; they become linear before they are weighed.

use super::Hit;
use super::pages::{Page, Pages};
use glam::Vec3;
use trex_store::cluster::{ColourView, FrameView};
use trex_store::{PageFile, srgb};

/// What the colours of hits are made of, for a file that has some.
pub(super) struct HitColours {
    /// The linear value of each byte.
    linear: Box<[f32; 256]>,
}

impl HitColours {
    /// `None` for a file without colours, whose hits are white.
    pub(super) fn of(file: &PageFile) -> Option<HitColours> {
        let linear = || Box::new(std::array::from_fn(|byte| srgb::linear_of(byte as u8) as f32));
        (file.superblock().colour_page_count > 0).then(|| HitColours { linear: linear() })
    }

    /// The colour of `hit`, linear. White where its triangle has none, or the page of it is damaged.
    ///
    /// # Errors
    /// The page that is missing, without which there is no answer.
    pub(super) fn at(&self, file: &PageFile, pages: &mut impl Pages, hit: &Hit) -> Result<Vec3, u32> {
        let local = (hit.triangle - file.pages()[hit.page as usize].first_triangle) as usize;
        let Some(colours) = file.colour_page(hit.page, hit.triangle) else { return Ok(Vec3::ONE) };
        let coloured = (hit.triangle - file.pages()[colours as usize].first_triangle) as usize;
        let vertices = match pages.page(hit.page) {
            Page::Ready(frame) => vertices(frame, local),
            Page::Missing => return Err(hit.page),
            Page::Damaged => None,
        };
        let Some(vertices) = vertices else { return Ok(Vec3::ONE) };
        let bytes = match pages.page(colours) {
            Page::Ready(frame) => ColourView::new(frame).colours(coloured, vertices),
            Page::Missing => return Err(colours),
            Page::Damaged => return Ok(Vec3::ONE),
        };
        let linear = bytes.map(|colour| Vec3::from(colour.map(|byte| self.linear[usize::from(byte)])));
        Ok(linear
            .iter()
            .zip(hit.barycentric)
            .map(|(&colour, weight)| weight * colour)
            .sum::<Vec3>()
            .min(Vec3::ONE))
    }
}

/// The vertices of a triangle within its cluster.
fn vertices(frame: &[u8], local: usize) -> Option<[usize; 3]> {
    let mut found = None;
    FrameView::new(frame).for_each_cluster(|cluster| {
        let first = cluster.first_triangle();
        let Some(index) = local.checked_sub(first).filter(|&index| index < cluster.triangle_count()) else {
            return;
        };
        let leaf = (0..cluster.leaf_count()).rev().find(|&leaf| cluster.leaf_first(leaf) <= index);
        found = leaf.map(|leaf| cluster.triangle_vertices(leaf, index - cluster.leaf_first(leaf)));
    });
    found
}

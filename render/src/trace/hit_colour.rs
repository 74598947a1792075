//! The colour of a hit: of the corners of its triangle, weighed by where the ray met it. Read from a page of its own,
//! once the hit is known: traversal never asks for it.
//!
//! Corners are sRGB bytes; they become linear before they are weighed.

use super::Ray;
use super::pages::{Page, Pages};
use glam::{DVec3, Vec3};
use trex_store::PageFile;
use trex_store::cluster::{Colour, ColourView, FrameView};

/// The colour, linear, of the point where `ray` meets triangle `local` of `page` at `t`. White where the triangle has
/// none, or its page is damaged.
///
/// # Errors
/// The page that is missing, without which there is no answer.
pub(super) fn colour(
    file: &PageFile,
    pages: &mut impl Pages,
    (ray, t): (&Ray, f64),
    (page, local): (u32, usize),
) -> Result<Vec3, u32> {
    let Some(colours) = file.colour_page(page, local) else { return Ok(Vec3::ONE) };
    let Some((vertices, corners)) = (match pages.page(page) {
        Page::Ready(frame) => triangle(frame, local),
        Page::Missing => return Err(page),
        Page::Damaged => None,
    }) else {
        return Ok(Vec3::ONE);
    };
    let bytes = match pages.page(colours) {
        Page::Ready(frame) => ColourView::new(frame).colours(local, vertices),
        Page::Missing => return Err(colours),
        Page::Damaged => return Ok(Vec3::ONE),
    };
    let lattice = file.superblock().lattice;
    let point = (ray.at(t) - DVec3::from(lattice.origin)) / lattice.step();
    let weights = weights(corners.map(|q| DVec3::from(q.map(|v| v as f64))), point);
    Ok(bytes.iter().zip(weights).map(|(&colour, weight)| weight as f32 * linear(colour)).sum())
}

/// The vertices of a triangle within its cluster, and their places on the lattice.
fn triangle(frame: &[u8], local: usize) -> Option<([usize; 3], [[i64; 3]; 3])> {
    let mut found = None;
    FrameView::new(frame).for_each_cluster(|cluster| {
        let first = cluster.first_triangle();
        let Some(index) = local.checked_sub(first).filter(|&index| index < cluster.triangle_count()) else {
            return;
        };
        let leaf = (0..cluster.leaf_count()).rev().find(|&leaf| cluster.leaf_first(leaf) <= index);
        found = leaf.map(|leaf| {
            let vertices = cluster.triangle_vertices(leaf, index - cluster.leaf_first(leaf));
            (vertices, vertices.map(|vertex| cluster.vertex(vertex)))
        });
    });
    found
}

/// Barycentric coordinates of the point of a triangle's plane nearest to `point`, none below 0, together 1.
fn weights([a, b, c]: [DVec3; 3], point: DVec3) -> [f64; 3] {
    let normal = (b - a).cross(c - a);
    let area = |from: DVec3, to: DVec3| (from - point).cross(to - point).dot(normal).max(0.0);
    let parts = [area(b, c), area(c, a), area(a, b)];
    let sum: f64 = parts.iter().sum();
    // A needle without area has no inside.
    if sum > 0.0 { parts.map(|part| part / sum) } else { [1.0 / 3.0; 3] }
}

/// IEC 61966-2-1.
fn linear(colour: Colour) -> Vec3 {
    Vec3::from(colour.map(|byte| {
        let value = f32::from(byte) / 255.0;
        if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_the_weighed_mean_of_the_corners() {
        let corners = [DVec3::new(0.0, 0.0, 1.0), DVec3::new(4.0, 1.0, 0.0), DVec3::new(1.0, 5.0, 2.0)];
        for wanted in [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.2, 0.3, 0.5], [0.5, 0.5, 0.0]] {
            let point: DVec3 = corners.iter().zip(wanted).map(|(&corner, weight)| weight * corner).sum();
            for (found, wanted) in weights(corners, point).into_iter().zip(wanted) {
                assert!((found - wanted).abs() < 1e-12, "{found} for {wanted}");
            }
        }
        assert_eq!(weights([DVec3::ONE; 3], DVec3::ZERO), [1.0 / 3.0; 3]);
        assert_eq!((linear([255; 3]), linear([0; 3])), (Vec3::ONE, Vec3::ZERO));
        assert!((linear([188; 3]).x - 0.5).abs() < 0.01);
    }
}

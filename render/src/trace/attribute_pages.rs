//! What shades a hit: its colour and its shading normal, of the corners of its triangle, weighed by where the ray met
//! it. Read from pages of their own, by whoever shades the hit: traversal never asks for them.
//!
//! Corners have sRGB bytes, which become linear before they are weighed. A corner without a normal, and one whose
//! normal is on the other side of the triangle than its corners say, is brought to their side.

use super::pages::{Page, Pages};
use super::{Hit, ShadedHit};
use glam::Vec3;
use trex_store::cluster::{Colour, CornerValue, Frame, FrameView, Normal, ValueView};
use trex_store::layout::PageKind;
use trex_store::{AttributeSet, PageFile, srgb};

/// The pages of colours and of normals, for a file that has some.
pub(super) struct AttributePages {
    has: AttributeSet,
    /// The linear value of each byte.
    linear: Box<[f32; 256]>,
}

impl AttributePages {
    /// `None` for a file without attributes, whose hits are white and flat.
    pub(super) fn of(file: &PageFile) -> Option<AttributePages> {
        let linear = || Box::new(std::array::from_fn(|byte| srgb::linear_of(byte as u8) as f32));
        let has = file.superblock().attributes();
        (has != AttributeSet::default()).then(|| AttributePages { has, linear: linear() })
    }

    /// The colour and the shading normal of `hit`. White and flat where its triangle has none, or the page of them is
    /// damaged.
    ///
    /// # Errors
    /// The page that is missing, without which there is no answer.
    pub(super) fn shade(&self, file: &PageFile, pages: &mut impl Pages, hit: Hit) -> Result<ShadedHit, u32> {
        let mut shaded = ShadedHit::from(hit);
        let vertices = match pages.page(hit.page) {
            Page::Ready(frame) => vertices(frame, place_in(file, hit.page, &hit)),
            Page::Missing => return Err(hit.page),
            Page::Damaged => None,
        };
        let Some(vertices) = vertices else { return Ok(shaded) };
        if self.has.colours
            && let Some(colours) = values::<Colour>((file, PageKind::Colours), pages, (&hit, vertices))?
        {
            shaded.colour = self.colour(colours, hit.barycentric).to_array();
        }
        if self.has.normals
            && let Some(normals) = values::<Normal>((file, PageKind::Normals), pages, (&hit, vertices))?
        {
            shaded.shading_normal = shading_normal(normals, hit.barycentric, hit.normal.into()).to_array();
        }
        Ok(shaded)
    }

    /// The linear colour.
    fn colour(&self, colours: [Colour; 3], barycentric: [f32; 3]) -> Vec3 {
        let linear = colours.map(|colour| Vec3::from(colour.map(|byte| self.linear[usize::from(byte)])));
        let weighed = linear.iter().zip(barycentric).map(|(&colour, weight)| weight * colour);
        weighed.sum::<Vec3>().min(Vec3::ONE)
    }
}

/// Index of the triangle from the first on that a page, of the mesh or of values, is of.
fn place_in(file: &PageFile, page: u32, hit: &Hit) -> usize {
    (hit.triangle - file.pages()[page as usize].first_triangle) as usize
}

/// The values of the corners of a triangle with these vertices; `None` where it has none, or their page is damaged.
fn values<V: CornerValue>(
    (file, kind): (&PageFile, PageKind),
    pages: &mut impl Pages,
    (hit, vertices): (&Hit, [usize; 3]),
) -> Result<Option<[V; 3]>, u32> {
    let Some(page) = file.value_page(kind, hit.page, hit.triangle) else { return Ok(None) };
    let place = place_in(file, page, hit);
    match pages.page(page) {
        Page::Ready(frame) => Ok(Some(ValueView::new(frame.bytes()).values(place, vertices))),
        Page::Missing => Err(page),
        Page::Damaged => Ok(None),
    }
}

/// The unit normal that shades a triangle with unit normal `flat`, zero where it has none: on the same side, `flat`
/// itself where no direction is left.
fn shading_normal(normals: [Normal; 3], barycentric: [f32; 3], flat: Vec3) -> Vec3 {
    if normals == [Normal::NONE; 3] {
        return flat;
    }
    let beside = |normal: Normal| {
        let vector = normal.vector().map_or(flat, Vec3::from);
        if vector.dot(flat) < 0.0 { -vector } else { vector }
    };
    let weighed = normals.iter().zip(barycentric).map(|(&normal, weight)| weight * beside(normal));
    weighed.sum::<Vec3>().try_normalize().unwrap_or(flat)
}

/// The vertices of a triangle within its cluster.
fn vertices(frame: Frame<'_>, local: usize) -> Option<[usize; 3]> {
    let cluster = FrameView::new(frame).cluster_with(local)?;
    let index = local - cluster.first_triangle();
    let leaf = cluster.leaf_with(index);
    Some(cluster.triangle_vertices(leaf, index - cluster.leaf_first(leaf)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_are_weighed_on_the_side_of_the_triangle() {
        let of = |vector: [f64; 3]| Normal::from_vector(vector);
        let flat = Vec3::Z;
        let close = |a: Vec3, b: Vec3| assert!((a - b.normalize()).length() < 5e-3, "{a} {b}");
        let corners = [of([0.6, 0.0, 0.8]), of([0.0, 0.6, 0.8]), of([0.0, 0.0, 1.0])];
        close(shading_normal(corners, [1.0, 0.0, 0.0], flat), Vec3::new(0.6, 0.0, 0.8));
        close(shading_normal(corners, [0.5, 0.5, 0.0], flat), Vec3::new(0.3, 0.3, 0.8));
        // Inside out, as some exporters write them.
        close(shading_normal(corners, [0.5, 0.5, 0.0], -flat), Vec3::new(-0.3, -0.3, -0.8));
        let one_none = [corners[0], Normal::NONE, corners[2]];
        close(shading_normal(one_none, [0.0, 1.0, 0.0], flat), flat);
        assert_eq!(shading_normal([Normal::NONE; 3], [0.2, 0.3, 0.5], flat), flat);
    }
}

//! The attributes of a hit: its colour and its shading normal, of the corners of its triangle, weighed by where the ray
//! met it. Read from pages of their own, once the hit is known: traversal never asks for them.
//!
//! Corners have sRGB bytes, which become linear before they are weighed. A corner without a normal, and one whose
//! normal is on the other side of the triangle than its corners say, is brought to their side.

use super::Hit;
use super::pages::{Page, Pages};
use glam::Vec3;
use trex_store::cluster::{Colour, CornerValue, Frame, FrameView, Normal, ValueView};
use trex_store::layout::PageKind;
use trex_store::{AttributeSet, PageFile, srgb};

/// What the attributes of hits are made of, for a file that has some.
pub(super) struct HitAttributes {
    has: AttributeSet,
    /// The linear value of each byte.
    linear: Box<[f32; 256]>,
}

/// A triangle whose attributes are asked for: its vertices within its cluster, once they are known.
struct HitTriangle<'a> {
    file: &'a PageFile,
    page: u32,
    triangle: u32,
    vertices: Option<[usize; 3]>,
}

impl HitAttributes {
    /// `None` for a file without attributes, whose hits are white and flat.
    pub(super) fn of(file: &PageFile) -> Option<HitAttributes> {
        let linear = || Box::new(std::array::from_fn(|byte| srgb::linear_of(byte as u8) as f32));
        let has = file.superblock().attributes();
        (has != AttributeSet::default()).then(|| HitAttributes { has, linear: linear() })
    }

    /// Gives `hit` its colour and its shading normal. White and flat where its triangle has none, or the page of them
    /// is damaged.
    ///
    /// # Errors
    /// The page that is missing, without which there is no answer.
    pub(super) fn set(&self, file: &PageFile, pages: &mut impl Pages, hit: &mut Hit) -> Result<(), u32> {
        let mut of = HitTriangle { file, page: hit.page, triangle: hit.triangle, vertices: None };
        if self.has.colours
            && let Some(colours) = of.values::<Colour>(PageKind::Colours, pages)?
        {
            hit.colour = self.colour(colours, hit.barycentric).to_array();
        }
        if self.has.normals
            && let Some(normals) = of.values::<Normal>(PageKind::Normals, pages)?
        {
            hit.shading_normal = shading_normal(normals, hit.barycentric, hit.normal.into()).to_array();
        }
        Ok(())
    }

    /// The linear colour.
    fn colour(&self, colours: [Colour; 3], barycentric: [f32; 3]) -> Vec3 {
        let linear = colours.map(|colour| Vec3::from(colour.map(|byte| self.linear[usize::from(byte)])));
        let weighed = linear.iter().zip(barycentric).map(|(&colour, weight)| weight * colour);
        weighed.sum::<Vec3>().min(Vec3::ONE)
    }
}

impl HitTriangle<'_> {
    /// The values of its corners; `None` where it has none, or their page is damaged.
    fn values<V: CornerValue>(
        &mut self,
        kind: PageKind,
        pages: &mut impl Pages,
    ) -> Result<Option<[V; 3]>, u32> {
        let Some(values) = self.file.value_page(kind, self.page, self.triangle) else { return Ok(None) };
        let first = |page: u32| self.file.pages()[page as usize].first_triangle;
        if self.vertices.is_none() {
            let local = (self.triangle - first(self.page)) as usize;
            self.vertices = match pages.page(self.page) {
                Page::Ready(frame) => vertices(frame, local),
                Page::Missing => return Err(self.page),
                Page::Damaged => None,
            };
        }
        let Some(vertices) = self.vertices else { return Ok(None) };
        match pages.page(values) {
            Page::Ready(frame) => {
                let triangle = (self.triangle - first(values)) as usize;
                Ok(Some(ValueView::new(frame.bytes()).values(triangle, vertices)))
            }
            Page::Missing => Err(values),
            Page::Damaged => Ok(None),
        }
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
    let leaf = (0..cluster.leaf_count()).rev().find(|&leaf| cluster.leaf_first(leaf) <= index)?;
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

//! C-rays against exact geometry: what a ray is, what answers it, and who can answer.

mod answer;
mod arithmetic;
mod attribute_pages;
mod bvh;
mod caps;
mod corners;
mod crossings;
mod kernel;
mod lattice_ray;
mod naive;
mod paged_mesh;
mod paged_tracer;
mod pages;
mod parts;
mod pooled;
mod retry;
mod scalar;
mod shown;
mod shown_parts;
#[cfg(target_arch = "x86_64")]
mod simd;
mod stack;
mod want_list;

pub use answer::{crossings_all, intersect_all, intersect_shaded_all, occluded_all};
pub use arithmetic::Arithmetic;
pub use caps::OpenParts;
pub use corners::{MeshTriangle, read_triangles};
pub use naive::{NaiveMesh, NaiveTriangle};
pub use paged_mesh::{HITS_PER_RAY, PagedMesh};
pub use paged_tracer::PagedTracer;
pub(crate) use pages::NoPages;
pub use pages::{AllResident, Page, Pages};
pub use parts::{Parts, SECTIONS_MAX, Section};
pub use pooled::{MeshTracer, PooledPages, pooled_tracers, seated_tracers};
pub(crate) use retry::{Advance, Retry, WAIT};
pub use shown_parts::PartNeeds;

use glam::DVec3;

/// A ray in model space. Points on it are `origin + t * direction`, `0 <= t <= t_max`.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Start, model units.
    pub origin: [f64; 3],
    /// Direction; of unit length wherever a distance is read off `t`.
    pub direction: [f64; 3],
    /// End of the ray; `f64::INFINITY` for none.
    pub t_max: f64,
}

impl Ray {
    /// The ray from `origin` in `direction` to `t_max`, where those are vectors.
    #[inline]
    pub(crate) fn new(origin: DVec3, direction: DVec3, t_max: f64) -> Ray {
        Ray { origin: origin.to_array(), direction: direction.to_array(), t_max }
    }

    /// The point at parameter `t`, model units.
    #[inline]
    pub(crate) fn at(&self, t: f64) -> DVec3 {
        DVec3::from(self.origin) + t * DVec3::from(self.direction)
    }
}

/// The nearest point where a ray meets the mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hit {
    /// Parameter of the hit on the ray.
    pub t: f64,
    /// Store id of the triangle: the page's first id + index within the page.
    pub triangle: u32,
    /// Index of the page that holds it; 0 where there are no pages, `u32::MAX`, as the triangle, on the cap of a cut.
    pub page: u32,
    /// Index into the store's materials.
    pub material: u32,
    /// Weights of the triangle's corners at the hit, 0 to 1; together 1.
    pub barycentric: [f32; 3],
    /// Unit normal of the counter-clockwise side, model space (f64 cross product of the decoded corners).
    pub normal: [f32; 3],
    /// Bound on the distance between the true surface point and `origin + t * direction`, model units;
    /// secondary rays start off the surface by it.
    pub error: f64,
}

impl Hit {
    /// The triangle, and the page, of the cap of a cut: none.
    pub const OF_CAP: u32 = u32::MAX;
}

/// A hit, and what shades it: what its corners have beside their places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShadedHit {
    /// Where it is.
    pub hit: Hit,
    /// Colour of the mesh there, linear, by which the material's `kd` is multiplied; white where the file has none.
    pub colour: [f32; 3],
    /// Unit normal that shades the surface there, on the side of the hit's: of the corners' normals, weighed; that one
    /// itself where the file has none.
    pub shading_normal: [f32; 3],
}

impl From<Hit> for ShadedHit {
    /// White and flat.
    fn from(hit: Hit) -> ShadedHit {
        ShadedHit { hit, colour: [1.0; 3], shading_normal: hit.normal }
    }
}

/// The answer for one ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Answer<T> {
    /// Exact: every page that could change it was there.
    Exact(T),
    /// A page that could change the answer is missing; it was recorded, ask again when it has come.
    Blocked,
}

impl<T> Answer<T> {
    /// What `change` makes of an exact answer.
    pub(crate) fn map<U>(self, change: impl FnOnce(T) -> U) -> Answer<U> {
        match self {
            Answer::Exact(answer) => Answer::Exact(change(answer)),
            Answer::Blocked => Answer::Blocked,
        }
    }
}

/// Answers rays against a triangle mesh. One per worker thread: it owns scratch memory and page pins.
/// Implementations: the paged clusters, and the naive mesh in memory that serves as oracle.
pub trait Tracer {
    /// Closest hit of `ray`, if it meets anything.
    fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>>;

    /// Answers whether `ray` meets anything.
    fn occluded(&mut self, ray: &Ray) -> Answer<bool>;

    /// What shades `hit`, which `intersect` has just found: read from pages of its own, for whoever shades it. White
    /// and flat where the mesh has no colours and no normals.
    fn shade(&mut self, hit: Hit) -> Answer<ShadedHit> {
        Answer::Exact(hit.into())
    }

    /// Closest hit of `ray`, and what shades it. Blocked also where that is missing.
    fn intersect_shaded(&mut self, ray: &Ray) -> Answer<Option<ShadedHit>> {
        let hit = self.intersect(ray);
        self.shade_answer(hit)
    }

    /// As [`Tracer::shade`], of an answer.
    fn shade_answer(&mut self, answer: Answer<Option<Hit>>) -> Answer<Option<ShadedHit>> {
        let Answer::Exact(Some(hit)) = answer else { return answer.map(|_| None) };
        self.shade(hit).map(Some)
    }

    /// Closest hits of rays that go much the same way, such as those of a tile: the answers that each gets alone,
    /// appended to `answers`.
    fn intersect_coherent(&mut self, rays: &[Ray], answers: &mut Vec<Answer<Option<Hit>>>) {
        answers.extend(rays.iter().map(|ray| self.intersect(ray)));
    }

    /// Answers whether rays that go much the same way meet anything, each by itself; appended to `answers`.
    fn occluded_coherent(&mut self, rays: &[Ray], answers: &mut Vec<Answer<bool>>) {
        answers.extend(rays.iter().map(|ray| self.occluded(ray)));
    }

    /// The pages of the worker, for rays through the units of the lower octrees. A tracer without pages has none to be
    /// had.
    fn lend_pages(&mut self) -> &mut dyn Pages {
        // It has no bytes: nothing is allocated, and nothing leaks.
        Box::leak(Box::new(NoPages))
    }
}

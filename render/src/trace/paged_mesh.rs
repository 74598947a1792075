//! `PagedMesh`: the tracer of page files. Chooses the kernel, makes the answer, says which missing pages block a ray.
//!
//! Error of a hit, in lattice steps: corners as seen from the entry are exact but for the fraction; the refined t is
//! f64, and it alone decides whether a ray meets the triangle that it left. What is left is the model's own coordinate
//! rounding, and the kernel's across the ray: 2^-18 of the triangle's size holds both.
//!
//! Invariants: 1. an `Exact` answer does not depend on which pages were there; 2. a ray that is Blocked has told its
//! pages of each missing page that could change its answer, once.

use super::arithmetic::Arithmetic;
use super::attribute_pages::AttributePages;
use super::bvh::{AnyHit, ClosestHit, Found, Goal, LatticeScene, MissingPages, RayEnd, trace_ray};
use super::crossings::trace_crossings;
use super::lattice_ray::{LatticeFrame, RefinedHit, Span};
use super::pages::Pages;
use super::scalar::Scalar;
use super::shown_parts::ShownParts;
#[cfg(target_arch = "x86_64")]
use super::simd::{PACKET_RAYS, PacketRoom};
use super::stack::Stack;
use super::{Answer, Hit, Ray, ShadedHit, Tracer};
use glam::DVec3;
use std::sync::Arc;
use trex_store::PageFile;

/// Traces rays against the clusters of a file, through whatever gives it pages.
pub struct PagedMesh<P> {
    pub(super) scene: LatticeScene,
    pub(super) pages: P,
    arithmetic: Arithmetic,
    pub(super) stack: Stack,
    #[cfg(target_arch = "x86_64")]
    packet: Box<PacketRoom>,
    /// Of the last ray.
    pub(super) missing: MissingPages,
    /// What is shown of the model; `None` for all of it.
    pub(super) shown: Option<Box<ShownParts>>,
}

/// Share of a triangle's size that a surface point may be off its plane for the f32 test.
const PLANE_ERROR: f64 = 1.0 / (1 << 18) as f64;
/// Rounding of model coordinates: a few operations in f64.
pub(super) const MODEL_ERROR: f64 = 1.0 / (1u64 << 50) as f64;

/// Most hits of a ray that are listed: what a list must have a bound for, and above what surfaces have.
pub const HITS_PER_RAY: usize = 1 << 20;

impl<P: Pages> PagedMesh<P> {
    /// A tracer of `file` with the fastest arithmetic, through `pages`.
    pub fn new(file: &Arc<PageFile>, pages: P) -> PagedMesh<P> {
        PagedMesh::with_arithmetic(file, pages, Arithmetic::for_file(file))
    }

    /// A tracer of `file` with a chosen arithmetic, through `pages`.
    ///
    /// # Panics
    /// For f32 on a lattice of more than 24 bits, and for AVX2 where the machine has none.
    pub fn with_arithmetic(file: &Arc<PageFile>, pages: P, arithmetic: Arithmetic) -> PagedMesh<P> {
        arithmetic.check(file);
        let scene = LatticeScene {
            file: file.clone(),
            frame: LatticeFrame::new(file),
            attributes: AttributePages::of(file),
            hidden: Vec::new(),
        };
        PagedMesh {
            scene,
            pages,
            arithmetic,
            stack: Stack::new(),
            #[cfg(target_arch = "x86_64")]
            packet: Default::default(),
            missing: MissingPages::none(),
            shown: None,
        }
    }

    /// The arithmetic that traces.
    pub fn arithmetic(&self) -> Arithmetic {
        self.arithmetic
    }

    /// The pages that rays are traced through.
    pub fn pages(&self) -> &P {
        &self.pages
    }

    /// The pages that rays are traced through.
    pub fn pages_mut(&mut self) -> &mut P {
        &mut self.pages
    }

    pub(super) fn run<G: Goal>(&mut self, ray: &Ray) -> Option<RayEnd> {
        let PagedMesh { scene, pages, stack, missing, .. } = self;
        missing.clear();
        match self.arithmetic {
            #[cfg(target_arch = "x86_64")]
            Arithmetic::Avx2 => super::simd::trace::<P, G>(scene, pages, stack, ray, missing),
            Arithmetic::Scalar => trace_ray::<Scalar<f32>, P, G>(scene, pages, stack, ray, missing),
            Arithmetic::Deep => trace_ray::<Scalar<f64>, P, G>(scene, pages, stack, ray, missing),
        }
    }

    /// All hits of `ray`, appended to `hits` by rising t: each crossing of the surface once, see `crossings`. Of more
    /// than [`HITS_PER_RAY`] any, and one more than that. Blocked: nothing is appended.
    pub fn crossings(&mut self, ray: &Ray, hits: &mut Vec<Hit>) -> Answer<()> {
        let PagedMesh { scene, pages, stack, missing, .. } = self;
        missing.clear();
        let first = hits.len();
        let mut tell = |span: &Span, found: &Found, _| {
            let found = hit(&scene.frame, ray, span, found);
            if found.t >= 0.0 && found.t <= ray.t_max && hits.len() - first <= HITS_PER_RAY {
                hits.push(found);
            }
        };
        trace_crossings(scene, pages, stack, ray, missing, &mut tell);
        if missing.count > 0 {
            want(pages, missing, f64::INFINITY);
            hits.truncate(first);
            return Answer::Blocked;
        }
        hits[first..].sort_unstable_by(|a, b| a.t.total_cmp(&b.t).then(a.triangle.cmp(&b.triangle)));
        Answer::Exact(())
    }

    /// Traces rays in packets; `outside` is the answer of those that miss the model's box.
    #[cfg(target_arch = "x86_64")]
    fn packets<A: Copy, G: Goal>(
        &mut self,
        rays: &[Ray],
        (outside, answers): (A, &mut Vec<A>),
        answer: impl Fn(&LatticeScene, &mut P, &Ray, &RayEnd, &MissingPages) -> A,
    ) {
        let PagedMesh { scene, pages, stack, packet, .. } = self;
        for rays in rays.chunks(PACKET_RAYS) {
            super::simd::packet::<P, G>(scene, pages, stack, rays, packet);
            let first = answers.len();
            answers.resize(first + rays.len(), outside);
            for ((ended, missing), &place) in packet.ended.iter().zip(&packet.missing).zip(&packet.places) {
                answers[first + place] = answer(scene, pages, &rays[place], ended, missing);
            }
        }
    }
}

/// The answer of a ray that asked for the closest hit.
pub(super) fn closest(
    pages: &mut impl Pages,
    (scene, ray): (&LatticeScene, &Ray),
    RayEnd { span, found }: &RayEnd,
    missing: &MissingPages,
) -> Answer<Option<Hit>> {
    let hit_t = found.as_ref().map_or(f64::INFINITY, |f| f.refined.t);
    if missing.count > 0 && missing.nearest <= hit_t {
        want(pages, missing, hit_t);
        return Answer::Blocked;
    }
    let hit = found.as_ref().map(|found| hit(&scene.frame, ray, span, found));
    Answer::Exact(hit.filter(|hit| hit.t >= 0.0 && hit.t <= ray.t_max))
}

/// The answer of a ray that asked for any.
pub(super) fn any(pages: &mut impl Pages, ended: &RayEnd, missing: &MissingPages) -> Answer<bool> {
    if ended.found.is_some() {
        return Answer::Exact(true);
    }
    if missing.count > 0 {
        want(pages, missing, f64::INFINITY);
        return Answer::Blocked;
    }
    Answer::Exact(false)
}

/// Tells of the missing pages that begin before a hit.
pub(super) fn want(pages: &mut impl Pages, missing: &MissingPages, before: f64) {
    for &(page, _) in missing.pages[..missing.count].iter().filter(|(_, t)| *t <= before) {
        pages.want(page);
    }
}

fn hit(frame: &LatticeFrame, ray: &Ray, span: &Span, found: &Found) -> Hit {
    let RefinedHit { t, normal, size, weights: [u, v, w] } = found.refined;
    let t = span.model_t(t);
    let n = DVec3::from(normal);
    let length = n.length();
    let (origin, way) = (DVec3::from(ray.origin), t * DVec3::from(ray.direction));
    let reach = (origin.abs() + way.abs()).max_element();
    let normal = if length > 0.0 { (n / length).as_vec3().to_array() } else { [0.0; 3] };
    Hit {
        t,
        triangle: found.triangle,
        page: found.page,
        material: u32::from(found.material),
        barycentric: [u, v, w].map(|weight| (weight / (u + v + w)) as f32),
        normal,
        error: (size + 1.0) * PLANE_ERROR * frame.step() + MODEL_ERROR * reach,
    }
}

impl<P: Pages> Tracer for PagedMesh<P> {
    fn lend_pages(&mut self) -> &mut dyn Pages {
        &mut self.pages
    }

    fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
        if self.shown.is_some() {
            return self.intersect_shown(ray);
        }
        match self.run::<ClosestHit>(ray) {
            Some(ended) => closest(&mut self.pages, (&self.scene, ray), &ended, &self.missing),
            None => Answer::Exact(None),
        }
    }

    fn occluded(&mut self, ray: &Ray) -> Answer<bool> {
        if self.shown.is_some() {
            return self.occluded_shown(ray);
        }
        match self.run::<AnyHit>(ray) {
            Some(ended) => any(&mut self.pages, &ended, &self.missing),
            None => Answer::Exact(false),
        }
    }

    fn shade(&mut self, hit: Hit) -> Answer<ShadedHit> {
        if hit.page == Hit::OF_CAP {
            return Answer::Exact(self.shaded_cap(hit));
        }
        let PagedMesh { scene, pages, .. } = self;
        let Some(attributes) = &scene.attributes else { return Answer::Exact(hit.into()) };
        let shaded = attributes.shade(&scene.file, pages, hit);
        shaded.inspect_err(|missing| pages.want(*missing)).map_or(Answer::Blocked, Answer::Exact)
    }

    fn intersect_coherent(&mut self, rays: &[Ray], answers: &mut Vec<Answer<Option<Hit>>>) {
        #[cfg(target_arch = "x86_64")]
        if self.arithmetic == Arithmetic::Avx2 && self.shown.is_none() {
            let outside = Answer::Exact(None);
            return self.packets::<_, ClosestHit>(
                rays,
                (outside, answers),
                |scene, pages, ray, ended, missing| closest(pages, (scene, ray), ended, missing),
            );
        }
        answers.extend(rays.iter().map(|ray| self.intersect(ray)));
    }

    fn occluded_coherent(&mut self, rays: &[Ray], answers: &mut Vec<Answer<bool>>) {
        #[cfg(target_arch = "x86_64")]
        if self.arithmetic == Arithmetic::Avx2 && self.shown.is_none() {
            let outside = Answer::Exact(false);
            return self.packets::<_, AnyHit>(rays, (outside, answers), |_, pages, _, ended, missing| {
                any(pages, ended, missing)
            });
        }
        answers.extend(rays.iter().map(|ray| self.occluded(ray)));
    }
}

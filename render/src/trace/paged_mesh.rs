//! `PagedMesh`: the tracer of page files. Chooses the kernel, makes the answer, keeps the list of missing pages.
//!
//! Error of a hit, in lattice steps: corners as seen from the entry are exact but for the fraction; the refined t is
//! f64, and it alone decides whether a ray meets the triangle that it left. What is left is the model's own coordinate
//! rounding, and the kernel's across the ray: 2^-18 of the triangle's size holds both.
//!
//! Invariants: 1. an `Exact` answer does not depend on which pages were there; 2. `wanted` holds each page once,
//! with the number of rays that it blocked.

use super::arithmetic::Arithmetic;
use super::bvh::{Any, Closest, Ended, Found, Goal, Missing, Scene, trace_ray};
use super::lattice_ray::{LatticeFrame, Refined, Span};
use super::pages::{Page, Pages};
use super::scalar::Scalar;
#[cfg(target_arch = "x86_64")]
use super::simd::{PACKET_RAYS, PacketRoom};
use super::stack::Stack;
use super::{Answer, Hit, Ray, Tracer};
use glam::DVec3;
use std::sync::Arc;
use trex_store::PageFile;

/// Traces rays against the clusters of a file, through whatever gives it pages.
pub struct PagedMesh<P> {
    scene: Scene,
    pages: P,
    arithmetic: Arithmetic,
    stack: Stack,
    #[cfg(target_arch = "x86_64")]
    packet: Box<PacketRoom>,
    /// Of the last ray.
    missing: Missing,
    wanted: Wanted,
}

/// Pages that blocked rays, each once, and how many rays each blocked.
struct Wanted {
    pages: Vec<u32>,
    /// By page; 0 for one that is not wanted.
    rays: Vec<u32>,
}

/// Share of a triangle's size that a surface point may be off its plane for the f32 test.
const PLANE_ERROR: f64 = 1.0 / (1 << 18) as f64;
/// Rounding of model coordinates: a few operations in f64.
const MODEL_ERROR: f64 = 1.0 / (1u64 << 50) as f64;

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
        let scene = Scene { file: file.clone(), frame: LatticeFrame::new(file) };
        PagedMesh {
            scene,
            pages,
            arithmetic,
            stack: Stack::new(),
            #[cfg(target_arch = "x86_64")]
            packet: Default::default(),
            missing: Missing::none(),
            wanted: Wanted { pages: Vec::new(), rays: vec![0; file.pages().len()] },
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

    /// Moves the pages that blocked rays since the last call to `into`, with how many rays each blocked.
    pub fn take_wanted(&mut self, into: &mut Vec<(u32, u32)>) {
        into.clear();
        let Wanted { pages, rays } = &mut self.wanted;
        into.extend(pages.drain(..).map(|page| (page, std::mem::take(&mut rays[page as usize]))));
    }

    /// Bytes that the list of missing pages of a file of `page_count` pages takes at most: the table, the list, which
    /// grows by doubling, and what it is moved to.
    pub(super) fn wanted_bytes(page_count: usize) -> u64 {
        ((3 * size_of::<u32>() + size_of::<(u32, u32)>()) * page_count) as u64
    }

    fn run<G: Goal>(&mut self, ray: &Ray) -> Option<Ended> {
        let PagedMesh { scene, pages, stack, missing, .. } = self;
        missing.clear();
        match self.arithmetic {
            #[cfg(target_arch = "x86_64")]
            Arithmetic::Avx2 => super::simd::trace::<P, G>(scene, pages, stack, ray, missing),
            Arithmetic::Scalar => trace_ray::<Scalar<f32>, P, G>(scene, pages, stack, ray, missing),
            Arithmetic::Deep => trace_ray::<Scalar<f64>, P, G>(scene, pages, stack, ray, missing),
        }
    }

    /// Traces rays in packets; `outside` is the answer of those that miss the model's box.
    #[cfg(target_arch = "x86_64")]
    fn packets<A: Copy, G: Goal>(
        &mut self,
        rays: &[Ray],
        (outside, answers): (A, &mut Vec<A>),
        answer: impl Fn(&mut Wanted, &Ray, &Ended, &Missing) -> A,
    ) {
        let PagedMesh { scene, pages, stack, packet, wanted, .. } = self;
        for rays in rays.chunks(PACKET_RAYS) {
            super::simd::packet::<P, G>(scene, pages, stack, rays, packet);
            let first = answers.len();
            answers.resize(first + rays.len(), outside);
            for ((ended, missing), &place) in packet.ended.iter().zip(&packet.missing).zip(&packet.places) {
                answers[first + place] = answer(wanted, &rays[place], ended, missing);
            }
        }
    }
}

impl Wanted {
    /// The answer of a ray that asked for the closest hit.
    fn closest(
        &mut self,
        frame: &LatticeFrame,
        ray: &Ray,
        Ended { span, found }: &Ended,
        missing: &Missing,
    ) -> Answer<Option<Hit>> {
        let hit_t = found.as_ref().map_or(f64::INFINITY, |f| f.refined.t);
        if missing.count > 0 && missing.nearest <= hit_t {
            self.note(missing, hit_t);
            return Answer::Blocked;
        }
        let hit = found.as_ref().map(|found| hit(frame, ray, span, found));
        Answer::Exact(hit.filter(|hit| hit.t >= 0.0 && hit.t <= ray.t_max))
    }

    /// The answer of a ray that asked for any.
    fn any(&mut self, ended: &Ended, missing: &Missing) -> Answer<bool> {
        if ended.found.is_some() {
            return Answer::Exact(true);
        }
        if missing.count > 0 {
            self.note(missing, f64::INFINITY);
            return Answer::Blocked;
        }
        Answer::Exact(false)
    }

    fn note(&mut self, missing: &Missing, before: f64) {
        for &(page, _) in missing.pages[..missing.count].iter().filter(|(_, t)| *t <= before) {
            self.add(page);
        }
    }

    /// One ray more that a page blocks.
    fn add(&mut self, page: u32) {
        let rays = &mut self.rays[page as usize];
        if *rays == 0 {
            self.pages.push(page);
        }
        *rays = rays.saturating_add(1);
    }
}

fn hit(frame: &LatticeFrame, ray: &Ray, span: &Span, found: &Found) -> Hit {
    let Refined { t, normal, size } = found.refined;
    let t = span.model_t(t);
    let n = DVec3::from(normal);
    let length = n.length();
    let (origin, way) = (DVec3::from(ray.origin), t * DVec3::from(ray.direction));
    let reach = (origin.abs() + way.abs()).max_element();
    Hit {
        t,
        triangle: found.triangle,
        page: found.page,
        material: u32::from(found.material),
        normal: if length > 0.0 { (n / length).as_vec3().to_array() } else { [0.0; 3] },
        error: (size + 1.0) * PLANE_ERROR * frame.step() + MODEL_ERROR * reach,
    }
}

impl<P: Pages> Tracer for PagedMesh<P> {
    #[inline]
    fn unit_page(&mut self, page: u32) -> Page<'_> {
        let found = self.pages.page(page);
        if matches!(found, Page::Missing) {
            self.wanted.add(page);
        }
        found
    }

    fn hold_unit_page(&self, page: u32) -> Option<Page<'_>> {
        self.pages.hold(page)
    }

    fn want_unit_page(&mut self, page: u32) {
        self.wanted.add(page);
    }

    fn let_go_unit_pages(&mut self) {
        self.pages.let_go();
    }

    fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
        match self.run::<Closest>(ray) {
            Some(ended) => self.wanted.closest(&self.scene.frame, ray, &ended, &self.missing),
            None => Answer::Exact(None),
        }
    }

    fn occluded(&mut self, ray: &Ray) -> Answer<bool> {
        match self.run::<Any>(ray) {
            Some(ended) => self.wanted.any(&ended, &self.missing),
            None => Answer::Exact(false),
        }
    }

    fn intersect_coherent(&mut self, rays: &[Ray], answers: &mut Vec<Answer<Option<Hit>>>) {
        #[cfg(target_arch = "x86_64")]
        if self.arithmetic == Arithmetic::Avx2 {
            let outside = Answer::Exact(None);
            let frame = self.scene.frame;
            return self.packets::<_, Closest>(rays, (outside, answers), |wanted, ray, ended, missing| {
                wanted.closest(&frame, ray, ended, missing)
            });
        }
        answers.extend(rays.iter().map(|ray| self.intersect(ray)));
    }

    fn occluded_coherent(&mut self, rays: &[Ray], answers: &mut Vec<Answer<bool>>) {
        #[cfg(target_arch = "x86_64")]
        if self.arithmetic == Arithmetic::Avx2 {
            let outside = Answer::Exact(false);
            return self.packets::<_, Any>(rays, (outside, answers), |wanted, _, ended, missing| {
                wanted.any(ended, missing)
            });
        }
        answers.extend(rays.iter().map(|ray| self.occluded(ray)));
    }
}

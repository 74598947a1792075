//! The conformance suite of G-stages: what every device has to answer, held against single rays of the scalar walk; and
//! the stages that it runs on here. Another stage comes in by one more line of `stages`.

use crate::fixtures::model_with;
use crate::voxels::rays_of_all_kinds;
use crate::voxels_lower_batch::{BatchStage as Setting, PartialPages, State, all_there, half_missing};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use trex_render::{
    Answer, CpuStage, GAnswer, GCall, GEnd, GKind, GNeeds, GRay, GRays, GStage, GTurn, GUnits, GView,
    LowerScene, MissingUnits, Occluders, Page, Pages, Ray, VoxelHit, VoxelScene, Voxels,
};
use trex_store::octree::{Refinement, UnitsView, UpperOctree};
use trex_store::{Budget, Result};

/// Makes a stage.
pub(crate) type NewStage = fn() -> Box<dyn GStage>;

/// The stages, by name.
pub(crate) fn stages() -> Vec<(&'static str, NewStage)> {
    let everywhere: [(&str, NewStage); 3] = [
        ("naive", || Box::new(Naive::default())),
        ("processor", || Box::new(CpuStage::default())),
        ("late", || Box::new(Late::new())),
    ];
    #[cfg(feature = "gpu")]
    let everywhere = everywhere.into_iter().chain(crate::gpu::stage());
    everywhere.into_iter().collect()
}

/// One scalar ray at a time.
#[derive(Debug, Default)]
struct Naive(Option<Arc<Voxels>>);

impl GStage for Naive {
    fn set_octree(&mut self, octree: &Arc<Voxels>) -> Result<()> {
        self.0 = Some(octree.clone());
        Ok(())
    }

    fn needs(&self) -> GNeeds {
        GNeeds { batch_rays: 1, ray_bytes: 0, calls: 1, photons: 1 }
    }

    fn submit(&self, mut call: GCall, mut pages: &mut dyn Pages) -> GTurn {
        let (voxels, GView { occluders, units }) = (self.0.as_ref().unwrap(), call.view);
        let lower = match units {
            GUnits::None => None,
            GUnits::On(missing) => voxels.lower_scene(occluders).map(|lower| lower.on_missing(missing)),
        };
        for part in &mut call.parts {
            let (rays, answers) = part.parts_mut();
            for (ray, answer) in rays.iter().zip(answers) {
                *answer = match &lower {
                    Some(lower) => lower.answer(ray, &mut pages),
                    None => voxels.scene(occluders).answer(ray),
                };
            }
        }
        GTurn::Answered(call)
    }
}

/// Answers while the pages are lent, and hands the answers over later, on a thread of its own: of two calls the second
/// first.
#[derive(Debug)]
struct Late {
    inner: CpuStage,
    answered: Option<Sender<(GCall, Sender<GEnd>)>>,
    thread: Option<JoinHandle<()>>,
}

impl Late {
    fn new() -> Late {
        let (answered, late): (_, Receiver<(GCall, Sender<GEnd>)>) = channel();
        let thread = std::thread::spawn(move || {
            while let Ok(first) = late.recv() {
                let second = late.recv_timeout(std::time::Duration::from_millis(1)).ok();
                for (call, to) in second.into_iter().chain([first]) {
                    // Nobody may wait any more.
                    let _ = to.send(Box::new(|| call));
                }
            }
        });
        Late { inner: CpuStage::default(), answered: Some(answered), thread: Some(thread) }
    }
}

impl GStage for Late {
    fn set_octree(&mut self, octree: &Arc<Voxels>) -> Result<()> {
        self.inner.set_octree(octree)
    }

    fn needs(&self) -> GNeeds {
        GNeeds { calls: 2, ..self.inner.needs() }
    }

    fn submit(&self, call: GCall, pages: &mut dyn Pages) -> GTurn {
        let (to, turn) = channel();
        let call = self.inner.submit(call, pages).wait();
        self.answered.as_ref().unwrap().send((call, to)).unwrap();
        GTurn::UnderWay(turn)
    }
}

impl Drop for Late {
    fn drop(&mut self) {
        self.answered = None;
        self.thread.take().unwrap().join().unwrap();
    }
}

/// No units are asked for.
struct NoPages;

impl Pages for NoPages {
    fn page(&mut self, page: u32) -> Page<'_> {
        panic!("page {page} of a file without units")
    }
}

/// What the answers of a call are held against: single rays in model space.
struct SingleRays<'a> {
    octree: &'a UpperOctree,
    upper: VoxelScene<'a>,
    lower: Option<LowerScene<'a>>,
}

impl SingleRays<'_> {
    /// The ray as the stage takes it, and its distance to the cube.
    fn g_ray(&self, ray: &Ray, kind: GKind) -> (GRay, f64) {
        self.lower.map_or(self.upper.g_ray(ray, kind), |lower| lower.g_ray(ray, kind))
    }

    /// The hit of a single ray, with the page and the leaf of the unit that it is in; blocked where a page is missing.
    fn hit(
        &self,
        ray: &Ray,
        kind: GKind,
        pages: &mut impl Pages,
    ) -> Answer<Option<(VoxelHit, Option<[u32; 2]>)>> {
        match self.lower.filter(|_| matches!(kind, GKind::Shadow | GKind::Gather)) {
            None => Answer::Exact(self.upper.intersect(ray).map(|hit| (hit, None))),
            Some(lower) => match lower.intersect(ray, pages) {
                Answer::Blocked => Answer::Blocked,
                Answer::Exact(hit) => {
                    Answer::Exact(hit.map(|hit| (hit.upper, hit.lower.map(|lower| [lower.page, lower.leaf]))))
                }
            },
        }
    }

    /// Side of the subvoxels that a kind asks.
    fn subvoxel(&self, kind: GKind) -> f64 {
        let finest = self.lower.filter(|_| matches!(kind, GKind::Shadow | GKind::Gather));
        finest.map_or(self.upper.subvoxel_side(), |lower| lower.subvoxel_side())
    }

    fn check(&self, (ray, kind): (&Ray, GKind), answer: &GAnswer, pages: &mut impl Pages, name: &str) {
        let at = || format!("{name} {kind:?} {ray:?}: {answer:?}");
        let hit = match self.hit(ray, kind, pages) {
            Answer::Blocked => return assert_eq!(answer.outcome, GAnswer::BLOCKED, "{}", at()),
            Answer::Exact(None) => return assert_eq!(answer.outcome, GAnswer::NOTHING, "{}", at()),
            Answer::Exact(Some(hit)) => hit,
        };
        assert_eq!(answer.outcome, GAnswer::MET, "{}", at());
        if kind == GKind::Shadow {
            return;
        }
        let (VoxelHit { t, leaf, node, axis }, lower) = hit;
        let t_found = self.g_ray(ray, kind).1 + f64::from(answer.t) * self.subvoxel(kind);
        assert_eq!((t_found.to_bits(), answer.axis as usize), (t.to_bits(), axis), "{}", at());
        let voxel = match lower.map(|[page, leaf]| (pages.page(page), leaf)) {
            Some((Page::Ready(frame), leaf)) => UnitsView::new(frame.bytes()).leaf(leaf),
            _ => self.octree.leaf(leaf as usize),
        };
        assert_eq!(answer.material, u32::from(voxel.material), "{}", at());
        let dot = |u: [f32; 3], v: [f32; 3]| (0..3).map(|a| u[a] * v[a]).sum::<f32>();
        let way = ray.direction.map(|v| v as f32);
        let mut face = [0.0; 3];
        face[axis] = if way[axis].abs() > 1e-9 { -way[axis].signum() } else { 0.0 };
        // Bent, and seen from the front along its mean normal: the face of the voxel is what is met.
        let is_bent = voxel.flatness < 0.85 && -dot(way, voxel.normal) * dot(face, voxel.normal) < 0.0;
        let plane = if is_bent { face } else { voxel.normal };
        let (along, from) = (dot(answer.normal, plane), dot(answer.normal, way));
        // A ray along the plane may be on either side of it.
        let is_along = dot(plane, way).abs() < 1e-6 || plane == [0.0; 3];
        let is_plane = along.abs() > 1.0 - 1e-5 || is_along;
        assert!(is_plane && (is_along || from < 0.0), "{} {voxel:?}", at());
        if matches!(kind, GKind::Gather | GKind::Photon) {
            let upper = self.octree.leaf(leaf as usize).normal;
            let is_back = dot(answer.normal, upper) < 0.0;
            assert_eq!(answer.side, 2 * self.octree.facet(node, leaf) + u32::from(is_back), "{}", at());
        }
    }
}

/// Rays of a setting, each of some kind.
fn asked(setting: &Setting) -> Vec<(Ray, GKind)> {
    let kind = |at: usize| GKind::ALL[at * 7 % 11 % 4];
    setting.rays.iter().enumerate().map(|(at, ray)| (*ray, kind(at))).collect()
}

/// A call of these rays, in parts of so many.
fn call(expected: &SingleRays<'_>, view: GView, asked: &[(Ray, GKind)], part: usize) -> GCall {
    let parts = asked.chunks(part).map(|asked| {
        let mut rays = GRays::default();
        for (ray, kind) in asked {
            rays.push(expected.g_ray(ray, *kind).0);
        }
        rays
    });
    GCall { view, parts: parts.collect() }
}

/// The answers of a call that has come back, in the order of asking; it is whole.
fn answers(answered: &GCall, of: &GCall) -> Vec<GAnswer> {
    assert!(
        answered.view == of.view && answered.parts.len() == of.parts.len(),
        "a call comes back as it was"
    );
    for (part, before) in answered.parts.iter().zip(&of.parts) {
        assert!(part.rays() == before.rays() && part.answers().len() == part.rays().len());
    }
    answered.parts.iter().flat_map(|part| part.answers()).copied().collect()
}

/// Every view of an octree, with pages that are all there and with some that are not.
fn each_view(setting: &Setting, mut check: impl FnMut(&SingleRays<'_>, GView, fn(u32) -> State, &str)) {
    let octree = setting.voxels.octree();
    for occluders in [Occluders::On, Occluders::Off] {
        let upper = setting.voxels.scene(occluders);
        let units = [GUnits::None, GUnits::On(MissingUnits::Block), GUnits::On(MissingUnits::StandIn)];
        for units in units {
            let lower = match units {
                GUnits::None => None,
                GUnits::On(missing) => {
                    setting.voxels.lower_scene(occluders).map(|lower| lower.on_missing(missing))
                }
            };
            let expected = SingleRays { octree, upper, lower };
            for state in [all_there, half_missing] as [fn(u32) -> State; 2] {
                let name = format!("{} {occluders:?} {units:?}", setting.built.file.path().display());
                check(&expected, GView { occluders, units }, state, &name);
            }
        }
    }
}

pub(crate) fn settings() -> Vec<Setting> {
    vec![
        Setting::new("gen:pipes:30k:2", Refinement::By16, 2500),
        Setting::new("gen:scan:10k:2", Refinement::By4, 2500),
    ]
}

/// Each answer is that of its ray alone, whatever is asked beside it, in parts of whatever size; rays that a missing
/// page blocks have it wanted as often as single rays do.
#[test]
fn answers_are_those_of_single_rays() {
    for setting in settings() {
        let asked = asked(&setting);
        for (stage_name, stage) in stages() {
            let mut stage = stage();
            stage.set_octree(&setting.voxels).unwrap();
            let mut outcomes = [0; 3];
            each_view(&setting, |expected, view, state, name| {
                let name = format!("{stage_name} {name}");
                // It may keep units of its own, which answer where pages are missing: now it has none.
                stage.set_octree(&setting.voxels).unwrap();
                let mut single = PartialPages::new(&setting.all, state, usize::MAX);
                for part in [64, 1000, 1] {
                    let mut pages = PartialPages::new(&setting.all, state, usize::MAX);
                    let asked = if part == 1 { &asked[..100] } else { &asked[..] };
                    let before = call(expected, view, asked, part);
                    let found = stage.submit(call(expected, view, asked, part), &mut pages).wait();
                    single.wanted.clear();
                    for (asked, answer) in asked.iter().zip(answers(&found, &before)) {
                        expected.check((&asked.0, asked.1), &answer, &mut single, &name);
                        outcomes[answer.outcome as usize] += 1;
                    }
                    assert_eq!(pages.wanted, single.wanted, "{name}: pages wanted");
                }
            });
            assert!(outcomes.iter().all(|&count| count > 500), "{stage_name}: {outcomes:?}");
        }
    }
}

/// A ray that comes alone is answered with room for one page: so work ends that waits for pages with hardly any frames.
#[test]
fn a_ray_alone_needs_room_for_one_page() {
    let setting = Setting::new("gen:isosurface:20k:2", Refinement::By16, 80);
    for (name, stage) in stages() {
        let mut stage = stage();
        stage.set_octree(&setting.voxels).unwrap();
        each_view(&setting, |expected, view, state, view_name| {
            stage.set_octree(&setting.voxels).unwrap();
            for asked in asked(&setting).chunks(1) {
                let mut pages = PartialPages::new(&setting.all, state, 1);
                let mut single = PartialPages::new(&setting.all, state, 1);
                let before = call(expected, view, asked, 1);
                let found = stage.submit(call(expected, view, asked, 1), &mut pages).wait();
                let (ray, kind) = &asked[0];
                let answer = answers(&found, &before)[0];
                expected.check((ray, *kind), &answer, &mut single, &format!("{name} {view_name}"));
            }
        });
    }
}

/// Calls without rays, or with parts that have none, come back as they are.
#[test]
fn calls_without_rays_come_back() {
    let setting = Setting::new("gen:scan:10k:2", Refinement::By4, 10);
    for (name, stage) in stages() {
        let mut stage = stage();
        stage.set_octree(&setting.voxels).unwrap();
        let GNeeds { batch_rays, calls, photons, .. } = stage.needs();
        assert!(batch_rays > 0 && calls > 0 && photons > 0, "{name}");
        each_view(&setting, |_, view, state, _| {
            for parts in [0, 1, 3] {
                let parts = || (0..parts).map(|_| GRays::default()).collect();
                let mut pages = PartialPages::new(&setting.all, state, 4);
                let found = stage.submit(GCall { view, parts: parts() }, &mut pages).wait();
                assert!(answers(&found, &GCall { view, parts: parts() }).is_empty());
            }
        });
    }
}

/// Threads that call at a time, with several calls under way each, get their own answers.
#[test]
fn calls_of_many_threads_keep_apart() {
    let setting = Setting::new("gen:pipes:30k:2", Refinement::By16, 2400);
    let octree = setting.voxels.octree();
    let upper = setting.voxels.scene(Occluders::On);
    let expected = SingleRays { octree, upper, lower: setting.voxels.lower_scene(Occluders::On) };
    let view = GView { occluders: Occluders::On, units: GUnits::On(MissingUnits::Block) };
    let all = asked(&setting);
    for (name, stage) in stages() {
        let mut stage = stage();
        stage.set_octree(&setting.voxels).unwrap();
        std::thread::scope(|scope| {
            for asked in all.chunks(all.len() / 3) {
                let (stage, expected, setting) = (&stage, &expected, &setting);
                scope.spawn(move || {
                    let mut pages = PartialPages::new(&setting.all, all_there, usize::MAX);
                    let turns: Vec<_> = asked
                        .chunks(100)
                        .map(|asked| (asked, stage.submit(call(expected, view, asked, 30), &mut pages)))
                        .collect();
                    for (asked, turn) in turns.into_iter().rev() {
                        let answers = answers(&turn.wait(), &call(expected, view, asked, 30));
                        for ((ray, kind), answer) in asked.iter().zip(answers) {
                            expected.check((ray, *kind), &answer, &mut pages, name);
                        }
                    }
                });
            }
        });
    }
}

/// The octree that is set last is the one that is asked.
#[test]
fn another_octree_takes_the_place_of_the_first() {
    let models = ["gen:isosurface:20k:2", "gen:soup:10k:3"].map(|spec| {
        let built = model_with(spec, trex_store::build::Voxels::Resolution(64));
        let (octree, _lease) = built.file.upper(&Budget::unlimited()).unwrap().unwrap();
        let rays = rays_of_all_kinds(&built, &octree, 500);
        (Arc::new(Voxels::open(&built.file, &Budget::unlimited()).unwrap().unwrap()), rays)
    });
    let view = GView { occluders: Occluders::On, units: GUnits::None };
    for (name, stage) in stages() {
        let mut stage = stage();
        for (octree, asked) in &models {
            stage.set_octree(octree).unwrap();
            let (scene, mut rays) = (octree.scene(Occluders::On), GRays::default());
            for ray in asked {
                rays.push(scene.g_ray(ray, GKind::Far).0);
            }
            let found = stage.submit(GCall { view, parts: vec![rays] }, &mut NoPages).wait();
            let mut met = 0;
            for (ray, answer) in asked.iter().zip(found.parts[0].answers()) {
                let expected = scene.intersect(ray).is_some();
                assert_eq!(answer.outcome == GAnswer::MET, expected, "{name}: {ray:?}");
                met += usize::from(expected);
            }
            assert!((50..450).contains(&met), "{name}: {met} rays meet anything");
        }
    }
}

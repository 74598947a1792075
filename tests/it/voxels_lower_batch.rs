//! Rays through units in lanes: against the scalar walk, with the same pages there, missing, damaged or without room.

use crate::command::cannot_run;
use crate::support::Built;
use crate::voxels::rays_of_all_kinds;
use crate::voxels_lower::refined;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use trex_render::{
    AllResident, Answer, LowerHit, LowerScene, MissingUnits, Occluders, PacketWidth, Page, Pages,
    PooledPages, Ray, Voxels,
};
use trex_store::octree::Refinement;
use trex_store::pool::{PagePool, PoolOptions, Seats, Want};
use trex_store::{Budget, PageFile};

/// What becomes of a page that is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum State {
    There,
    Missing,
    Damaged,
}

/// All pages of a file, of which some can be had, and few be held at a time.
pub(crate) struct PartialPages<'a> {
    all: &'a AllResident,
    state: fn(u32) -> State,
    room: usize,
    held: RefCell<BTreeSet<u32>>,
    /// How many rays each page has blocked.
    pub(crate) wanted: BTreeMap<u32, u32>,
    times_let_go: usize,
}

impl<'a> PartialPages<'a> {
    pub(crate) fn new(all: &'a AllResident, state: fn(u32) -> State, room: usize) -> PartialPages<'a> {
        PartialPages { all, state, room, held: RefCell::default(), wanted: BTreeMap::new(), times_let_go: 0 }
    }
}

impl Pages for PartialPages<'_> {
    fn page(&mut self, page: u32) -> Page<'_> {
        if !self.held.borrow().contains(&page) && self.held.borrow().len() >= self.room {
            self.held.get_mut().clear();
        }
        self.hold(page).expect("there is room for one")
    }

    fn hold(&self, page: u32) -> Option<Page<'_>> {
        let mut held = self.held.borrow_mut();
        if held.len() >= self.room && !held.contains(&page) {
            return None;
        }
        Some(match (self.state)(page) {
            State::There => {
                held.insert(page);
                Page::Ready(self.all.frame(page).into())
            }
            State::Missing => Page::Missing,
            State::Damaged => Page::Damaged,
        })
    }

    fn let_go(&mut self) {
        self.held.get_mut().clear();
        self.times_let_go += 1;
    }

    fn want(&mut self, page: u32) {
        assert_eq!((self.state)(page), State::Missing);
        *self.wanted.entry(page).or_default() += 1;
    }
}

/// A model, all pages, rays.
pub(crate) struct BatchStage {
    pub(crate) built: Arc<Built>,
    pub(crate) voxels: Arc<Voxels>,
    pub(crate) all: AllResident,
    pub(crate) rays: Vec<Ray>,
}

impl BatchStage {
    pub(crate) fn new(spec: &str, refinement: Refinement, ray_count: usize) -> BatchStage {
        let built = refined(spec, refinement);
        let budget = Budget::unlimited();
        let voxels = Arc::new(Voxels::open(&built.file, &budget).unwrap().unwrap());
        let all = AllResident::load(&built.file);
        let (octree, _lease) = built.file.upper(&budget).unwrap().unwrap();
        let rays = rays_of_all_kinds(&built, &octree, ray_count);
        BatchStage { built, voxels, all, rays }
    }

    fn each_scene(&self, mut check: impl FnMut(LowerScene<'_>, &str)) {
        for occluders in [Occluders::On, Occluders::Off] {
            for missing in [MissingUnits::Block, MissingUnits::StandIn] {
                let scene = self.voxels.lower_scene(occluders).unwrap().on_missing(missing);
                check(scene, &format!("{} {occluders:?} {missing:?}", self.built.file.path().display()));
            }
        }
    }

    /// Answers of the scalar walk, and of all widths; the shares of rays that are blocked, hit, and hit a stand-in.
    fn compare(
        &self,
        scene: &LowerScene<'_>,
        name: &str,
        (state, room): (fn(u32) -> State, usize),
    ) -> [f64; 3] {
        let mut shelf = PartialPages::new(&self.all, state, usize::MAX);
        let single: Vec<_> = self.rays.iter().map(|ray| scene.intersect(ray, &mut shelf)).collect();
        for width in widths() {
            let mut other = PartialPages::new(&self.all, state, room);
            let mut answers = vec![Answer::Blocked; self.rays.len()];
            scene.intersect_batch_with(width, &self.rays, &mut other, &mut answers);
            for ((answer, single), ray) in answers.iter().zip(&single).zip(&self.rays) {
                assert_eq!(bits(answer), bits(single), "{name} {width:?}, room for {room}: {ray:?}");
            }
            assert_eq!(other.wanted, shelf.wanted, "{name} {width:?}, room for {room}");
            assert_eq!(other.times_let_go > 0, room < 20 && width != PacketWidth::One, "{name} {width:?}");
        }
        let share = |is: fn(&Answer<Option<LowerHit>>) -> bool| {
            single.iter().filter(|answer| is(answer)).count() as f64 / single.len() as f64
        };
        [
            share(|answer| *answer == Answer::Blocked),
            share(|answer| matches!(answer, Answer::Exact(Some(_)))),
            share(|answer| matches!(answer, Answer::Exact(Some(hit)) if hit.is_stand_in)),
        ]
    }
}

fn widths() -> impl Iterator<Item = PacketWidth> {
    PacketWidth::ALL.into_iter().filter(|width| width.is_available())
}

/// All that an answer says, so that it can be compared bit for bit.
fn bits(answer: &Answer<Option<LowerHit>>) -> Answer<Option<impl PartialEq + std::fmt::Debug>> {
    match answer {
        Answer::Blocked => Answer::Blocked,
        Answer::Exact(hit) => Answer::Exact(hit.map(|LowerHit { upper, lower, is_stand_in }| {
            (upper.t.to_bits(), upper.leaf, upper.node, upper.axis, lower, is_stand_in)
        })),
    }
}

pub(crate) fn all_there(_: u32) -> State {
    State::There
}

/// Without any order: pages of a model are few.
pub(crate) fn half_missing(page: u32) -> State {
    if page.wrapping_mul(0x9e37_79b9) >> 31 == 0 { State::There } else { State::Missing }
}

fn some_damaged(page: u32) -> State {
    [State::There, State::Damaged, State::There, State::Missing]
        [(page.wrapping_mul(0x9e37_79b9) >> 30) as usize]
}

const STAGES: [(&str, Refinement); 4] = [
    ("gen:scan:10k:2", Refinement::By4),
    ("gen:pipes:30k:2", Refinement::By16),
    ("gen:isosurface:20k:2", Refinement::By16),
    ("gen:soup:10k:3", Refinement::By4),
];

#[test]
fn lanes_meet_in_units_what_single_rays_meet() {
    for width in PacketWidth::ALL.into_iter().filter(|width| !width.is_available()) {
        cannot_run(&format!("the machine has no such lanes: {width:?}"));
    }
    for (spec, refinement) in STAGES {
        let stage = BatchStage::new(spec, refinement, 4000);
        stage.each_scene(|scene, name| {
            let [blocked, hit, stands_in] = stage.compare(&scene, name, (all_there, usize::MAX));
            assert!(blocked == 0.0 && stands_in == 0.0 && (0.1..0.9).contains(&hit), "{name}: {hit}");
            let whole: Vec<_> = stage.rays.iter().map(|ray| scene.intersect(ray, &mut &stage.all)).collect();
            for batch in [1, 7, 64, 129] {
                let mut answers = vec![Answer::Blocked; 600];
                for (rays, answers) in stage.rays[..600].chunks(batch).zip(answers.chunks_mut(batch)) {
                    scene.intersect_batch(rays, &mut &stage.all, answers);
                }
                let is_same = answers.iter().zip(&whole).all(|(answer, whole)| bits(answer) == bits(whole));
                assert!(is_same, "{name}: {batch} at once");
            }
            scene.intersect_batch(&[], &mut &stage.all, &mut []);
        });
    }
}

/// The same rays are blocked by the same pages; or the same voxels stand in.
#[test]
fn lanes_take_missing_and_damaged_units_as_single_rays_do() {
    for (spec, refinement) in STAGES {
        let stage = BatchStage::new(spec, refinement, 4000);
        stage.each_scene(|scene, name| {
            let mut some_are_missing = 0.0;
            for state in [half_missing, some_damaged] {
                let [blocked, _, stands_in] = stage.compare(&scene, name, (state, usize::MAX));
                assert!(blocked == 0.0 || stands_in == 0.0, "{name}: one or the other");
                some_are_missing += blocked + stands_in;
            }
            assert!(some_are_missing > 0.05, "{name}: {some_are_missing}");
        });
    }
}

/// Where no more pages can be held, answers are the same.
#[test]
fn lanes_without_room_for_pages_answer_as_single_rays_do() {
    let stage = BatchStage::new("gen:isosurface:50k:2", Refinement::By16, 4000);
    stage.each_scene(|scene, name| {
        for room in [1, 2, 7] {
            stage.compare(&scene, name, (all_there, room));
            stage.compare(&scene, name, (some_damaged, room));
        }
    });
}

/// Pages of a pool, and which of them were wanted.
struct WantRecorder {
    pages: PooledPages,
    wanted: BTreeSet<u32>,
}

impl Pages for WantRecorder {
    fn page(&mut self, page: u32) -> Page<'_> {
        self.pages.page(page)
    }

    fn hold(&self, page: u32) -> Option<Page<'_>> {
        self.pages.hold(page)
    }

    fn let_go(&mut self) {
        self.pages.let_go();
    }

    fn want(&mut self, page: u32) {
        self.wanted.insert(page);
    }
}

/// Batches through a pool of few frames, asked again until none is blocked: pages come and go in between.
#[test]
fn batches_end_while_pages_come_and_go() {
    let stage = BatchStage::new("gen:isosurface:50k:2", Refinement::By16, 120);
    let scene = stage.voxels.lower_scene(Occluders::On).unwrap();
    let whole: Vec<_> = stage.rays.iter().map(|ray| scene.intersect(ray, &mut &stage.all)).collect();
    let file = Arc::new(PageFile::open(stage.built.file.path(), &Budget::unlimited()).unwrap());
    // Room for the pages of one ray and some more, of more than a thousand.
    for spare in [32 << 16, 200 << 16] {
        let defaults = PoolOptions { staging_slots: 2, ..PoolOptions::default() };
        let (overhead, smallest) = PagePool::smallest_bytes(&*file, &defaults).unwrap();
        let options = PoolOptions { frames_bytes: smallest - overhead + spare, ..defaults };
        let pool =
            Arc::new(PagePool::open(file.clone(), file.path(), &Budget::unlimited(), &options).unwrap());
        let mut pages = WantRecorder {
            pages: PooledPages::new(&pool, Arc::new(Seats::default()).assign().unwrap()),
            wanted: BTreeSet::new(),
        };
        let mut waiting: Vec<usize> = (0..stage.rays.len()).collect();
        let mut rounds = 0;
        while !waiting.is_empty() {
            // All that wait; then one alone, which keeps what has come for it.
            pages.let_go();
            let all = std::mem::take(&mut waiting);
            waiting = ask(&stage, &scene, &mut pages, &all, &whole);
            pages.bring(&pool);
            pages.let_go();
            let mut alone: Vec<usize> = waiting.pop().into_iter().collect();
            while !alone.is_empty() {
                rounds += 1;
                assert!(rounds < 50 * stage.rays.len(), "{} rays never end", waiting.len());
                alone = ask(&stage, &scene, &mut pages, &alone, &whole);
                pages.bring(&pool);
            }
        }
        let stats = pool.stats();
        assert!(stats.evictions > 0 || spare > 32 << 16, "{stats:?}");
    }
}

/// Asks these rays in a batch; gives those that are blocked.
fn ask(
    stage: &BatchStage,
    scene: &LowerScene<'_>,
    pages: &mut WantRecorder,
    waiting: &[usize],
    whole: &[Answer<Option<LowerHit>>],
) -> Vec<usize> {
    let rays: Vec<Ray> = waiting.iter().map(|&at| stage.rays[at]).collect();
    let mut answers = vec![Answer::Blocked; rays.len()];
    scene.intersect_batch(&rays, pages, &mut answers);
    let pairs = waiting.iter().zip(&answers);
    let blocked = pairs.filter(|(at, answer)| {
        assert!(**answer == Answer::Blocked || bits(answer) == bits(&whole[**at]));
        **answer == Answer::Blocked
    });
    blocked.map(|(&at, _)| at).collect()
}

impl WantRecorder {
    /// Waits until something has come of what is wanted.
    fn bring(&mut self, pool: &PagePool) {
        let wanted = std::mem::take(&mut self.wanted).into_iter().take(8);
        let wants: Vec<Want> = wanted.map(|page| Want { page, weight: 1 }).collect();
        let epoch = pool.epoch();
        pool.submit(0, &wants);
        if !wants.is_empty() {
            pool.wait_for_progress(epoch, Duration::from_millis(5));
        }
    }
}

//! Rays of a call as the kernels take them, and their words back as answers.
//!
//! ```text
//! rays   shadow, shadow, .. | other, other, ..       in the order of asking within each of the two
//! words  one each           | eight each
//! ```
//!
//! Invariants: 1. pieces of the rays, answered one after the other, give the pieces of the words; 2. each ray keeps
//! its place in the call.

use crate::words::{SURFACE_WORDS, UNANSWERED, WANT_SHIFT};
use trex_render::{GAnswer, GCall, GKind, GRay};

/// Rays of a call, shadow rays first, with their places in it.
#[derive(Debug, Default)]
pub(crate) struct PackedRays {
    rays: Vec<GRay>,
    places: Vec<u32>,
    shadow_count: usize,
}

/// Answers that were not read yet.
pub(crate) struct AnswersInWords<'a> {
    shadow: std::slice::Iter<'a, u32>,
    others: std::slice::ChunksExact<'a, u32>,
}

/// The answer of a device for one ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum DeviceAnswer {
    /// It is this.
    Whole(GAnswer),
    /// Finer voxels are in this page; the coarser ones say this.
    Wants(u32, GAnswer),
    /// There is none: the walk was too long.
    None,
}

impl PackedRays {
    /// Bytes that a ray of a call takes, beside the call: here, its words, and its answer before it has its place.
    pub(crate) const RAY_BYTES: usize = size_of::<GRay>() + size_of::<u32>() + 2 * size_of::<GAnswer>();

    /// The rays of `all` that stand in `places`.
    pub(crate) fn new(all: &[&GRay], places: impl Iterator<Item = u32>) -> PackedRays {
        PackedRays::in_order(places.map(|place| (place, all[place as usize])))
    }

    /// Those of a call, all of them.
    pub(crate) fn of_call(call: &GCall) -> PackedRays {
        PackedRays::in_order((0..).zip(call.parts.iter().flat_map(|part| part.rays())))
    }

    fn in_order<'a>(asked: impl Iterator<Item = (u32, &'a GRay)>) -> PackedRays {
        let mut packed = PackedRays::default();
        let (mut others, mut other_places) = (Vec::new(), Vec::new());
        for (place, ray) in asked {
            let (rays, places) = match ray.kind() {
                GKind::Shadow => (&mut packed.rays, &mut packed.places),
                _ => (&mut others, &mut other_places),
            };
            rays.push(*ray);
            places.push(place);
        }
        packed.shadow_count = packed.rays.len();
        packed.rays.append(&mut others);
        packed.places.append(&mut other_places);
        packed
    }

    /// Count of rays.
    pub(crate) fn len(&self) -> usize {
        self.rays.len()
    }

    /// The rays from `begin` to `end`: shadow rays, others.
    ///
    /// # Panics
    /// When there are fewer.
    pub(crate) fn piece(&self, begin: usize, end: usize) -> (&[GRay], &[GRay]) {
        self.rays[begin..end].split_at(self.shadow_count.clamp(begin, end) - begin)
    }

    /// Calls `put` with the place of each ray and its answer.
    ///
    /// # Panics
    /// When the words are not those of these rays.
    pub(crate) fn answers(&self, words: &[u32], mut put: impl FnMut(u32, DeviceAnswer)) {
        let mut answers = self.in_words(words);
        for (&place, ray) in self.places.iter().zip(&self.rays) {
            put(place, answers.of(ray));
        }
    }

    /// The answers in these words, in the order of asking.
    ///
    /// # Panics
    /// When the words are not those of these rays.
    pub(crate) fn in_words<'a>(&self, words: &'a [u32]) -> AnswersInWords<'a> {
        assert_eq!(words.len(), self.word_count(), "words of all rays");
        let (shadow, others) = words.split_at(self.shadow_count);
        AnswersInWords { shadow: shadow.iter(), others: others.chunks_exact(SURFACE_WORDS) }
    }

    /// Words of the answers.
    pub(crate) fn word_count(&self) -> usize {
        answer_words(self.rays.len(), self.shadow_count)
    }
}

impl AnswersInWords<'_> {
    /// The answer of the next ray, which is this one.
    ///
    /// # Panics
    /// When there are no more.
    pub(crate) fn of(&mut self, ray: &GRay) -> DeviceAnswer {
        DeviceAnswer::of(match ray.kind() {
            GKind::Shadow => GAnswer::bare(*self.shadow.next().expect("a word each")),
            _ => bytemuck::pod_read_unaligned(bytemuck::cast_slice(self.others.next().expect("eight each"))),
        })
    }
}

/// Words of the answers of so many rays, of which so many are shadow rays.
pub(crate) fn answer_words(rays: usize, shadow: usize) -> usize {
    shadow + SURFACE_WORDS * (rays - shadow)
}

impl DeviceAnswer {
    fn of(answer: GAnswer) -> DeviceAnswer {
        let (outcome, want) = (answer.outcome & ((1 << WANT_SHIFT) - 1), answer.outcome >> WANT_SHIFT);
        let answer = GAnswer { outcome, ..answer };
        match want {
            _ if outcome == UNANSWERED => DeviceAnswer::None,
            0 => DeviceAnswer::Whole(answer),
            page => DeviceAnswer::Wants(page - 1, answer),
        }
    }
}

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
        let (mut shadow, other): (Vec<u32>, Vec<u32>) =
            places.partition(|&place| all[place as usize].kind() == GKind::Shadow);
        let shadow_count = shadow.len();
        shadow.extend(other);
        let rays = shadow.iter().map(|&place| *all[place as usize]).collect();
        PackedRays { rays, places: shadow, shadow_count }
    }

    /// Those of a call, all of them.
    pub(crate) fn of_call(call: &GCall) -> PackedRays {
        let all: Vec<&GRay> = call.parts.iter().flat_map(|part| part.rays()).collect();
        PackedRays::new(&all, 0..all.len() as u32)
    }

    /// Count of rays.
    pub(crate) fn len(&self) -> usize {
        self.rays.len()
    }

    /// The rays from `begin` on, at most so many, and how many of them are shadow rays.
    pub(crate) fn piece(&self, begin: usize, most: usize) -> (&[GRay], usize) {
        let end = self.rays.len().min(begin + most);
        (&self.rays[begin..end], self.shadow_count.clamp(begin, end) - begin)
    }

    /// Calls `put` with the place of each ray and its answer.
    ///
    /// # Panics
    /// When the words are not those of these rays.
    pub(crate) fn answers(&self, words: &[u32], mut put: impl FnMut(u32, DeviceAnswer)) {
        assert_eq!(
            words.len(),
            PackedRays::word_count(self.rays.len(), self.shadow_count),
            "words of all rays"
        );
        let (shadow, other) = words.split_at(self.shadow_count);
        let answers = shadow.iter().map(|&outcome| GAnswer::bare(outcome)).chain(
            other
                .chunks_exact(SURFACE_WORDS)
                .map(|words| bytemuck::pod_read_unaligned(bytemuck::cast_slice(words))),
        );
        for (&place, answer) in self.places.iter().zip(answers) {
            put(place, DeviceAnswer::of(answer));
        }
    }

    /// Words of so many rays, of which so many are shadow rays.
    pub(crate) fn word_count(rays: usize, shadow: usize) -> usize {
        shadow + SURFACE_WORDS * (rays - shadow)
    }
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

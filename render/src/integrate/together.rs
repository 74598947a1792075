//! `Together`: the rays from the camera of a tile, traced as one: neighbours mostly meet the same pages and nodes.
//!
//! Invariant: a path gets the answer that it would get alone.

use super::context::RenderContext;
use super::lod::before;
use super::path_state::{Origin, Path, Stage};
use crate::trace::{Answer, Hit, Ray, Tracer};

/// Rays that are traced together, and their answers.
#[derive(Debug, Default)]
pub(crate) struct Together {
    rays: Vec<Ray>,
    answers: Vec<Answer<Option<Hit>>>,
}

impl Together {
    /// Bytes that the rays of so many paths take.
    pub(crate) fn bytes(path_count: usize) -> u64 {
        let asking = size_of::<(&mut Path, &mut bool, Ray, f64)>();
        // Vectors that grow by doubling.
        (2 * path_count * (size_of::<Ray>() + size_of::<Answer<Option<Hit>>>() + asking)) as u64
    }
}

impl RenderContext<'_> {
    /// Traces the rays from the camera of a tile's paths together: neighbours mostly meet the same pages and nodes. A
    /// path whose ray is blocked stays as it is, and is told so.
    pub(super) fn meet_together<'p, T: Tracer>(
        &self,
        paths: impl Iterator<Item = (&'p mut Path, &'p mut bool)>,
        tracer: &mut T,
        together: &mut Together,
    ) {
        let Together { rays, answers } = together;
        rays.clear();
        answers.clear();
        let mut asking = Vec::with_capacity(paths.size_hint().1.unwrap_or(0));
        for (path, is_blocked) in paths {
            let Stage::CRay(ray) = path.stage else { continue };
            let cut = self.cut(&ray, path);
            if let Some(part) = before(&ray, cut).filter(|_| matches!(path.origin, Origin::Camera)) {
                rays.push(part);
                asking.push((path, is_blocked, ray, cut));
            }
        }
        // What stands for the mesh in a preview: the voxels from the camera on, or nothing.
        let instead = if self.voxels.is_some() { 0.0 } else { f64::INFINITY };
        tracer.intersect_coherent(rays, answers);
        for ((path, is_blocked, ray, cut), answer) in asking.into_iter().zip(answers) {
            match tracer.shade_answer(*answer) {
                Answer::Blocked if self.is_preview => {
                    path.stage = Stage::Met { ray, cut: instead, found: None }
                }
                Answer::Blocked => *is_blocked = true,
                Answer::Exact(found) => path.stage = Stage::Met { ray, cut, found },
            }
        }
    }
}

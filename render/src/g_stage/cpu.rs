//! `CpuStage`: the G-stage on the processor: the rays of many tiles as one batch through the lanes of `voxel/simd`.
//!
//! Tried and lost: sorting the rays of a batch by kind, cell of the origin and octant of the direction (1,024 samples,
//! 4,096 rays, octree of 512): the walk takes as long as before, since neighbours of a tile read the same nodes
//! anyway, and the sort takes 5 % of a picture.

use super::{GCall, GNeeds, GRays, GStage, GTurn, GUnits};
use crate::trace::Pages;
use crate::voxel::{GAnswer, GRay, LowerScene, Voxels};
use std::sync::Arc;
use trex_store::Result;

/// Parts with fewer rays than this on average go through the lanes together: rays off mirrors are few.
const PART_RAYS_MIN: usize = 64;

/// The processor, as a stage: the worker that calls answers by itself.
#[derive(Clone, Debug, Default)]
pub struct CpuStage {
    voxels: Option<Arc<Voxels>>,
}

impl CpuStage {
    /// What it asks of who calls it. A batch of 512 samples that ask for eight rays each has 64 to 128 times as many
    /// rays as lanes have under way; twice as many are no faster, and take memory from pages. Through units, a ray
    /// takes its answer, what it found, where its cone begins to read coarser voxels, and its place among all, among
    /// those of a part, those that wait and those that are crowded out.
    pub const NEEDS: GNeeds = GNeeds {
        batch_rays: 4096,
        ray_bytes: size_of::<GAnswer>()
            + LowerScene::FOUND_BYTES
            + size_of::<&GRay>()
            + 2 * size_of::<[u32; 4]>(),
        calls: 1,
        photons: 512,
    };

    /// Answers the rays of all parts together by `answer`.
    fn answer_together(parts: &mut [GRays], answer: impl FnOnce(&[&GRay], &mut [GAnswer])) {
        let all: Vec<&GRay> = parts.iter().flat_map(|part| part.rays()).collect();
        let mut answers = vec![GAnswer::bare(GAnswer::BLOCKED); all.len()];
        answer(&all, &mut answers);
        let mut rest = answers.as_slice();
        for part in parts {
            let (_, places) = part.parts_mut();
            let own;
            (own, rest) = rest.split_at(places.len());
            places.copy_from_slice(own);
        }
    }
}

impl GStage for CpuStage {
    fn set_octree(&mut self, octree: &Arc<Voxels>) -> Result<()> {
        self.voxels = Some(octree.clone());
        Ok(())
    }

    fn needs(&self) -> GNeeds {
        CpuStage::NEEDS
    }

    fn submit(&self, mut call: GCall, pages: &mut dyn Pages) -> GTurn {
        let voxels = self.voxels.as_deref().expect("the octree is set");
        let lower = match call.view.units {
            GUnits::None => None,
            GUnits::On(missing) => {
                voxels.lower_scene(call.view.occluders).map(|lower| lower.on_missing(missing))
            }
        };
        let (upper, parts) = (voxels.scene(call.view.occluders), &mut call.parts);
        let rays: usize = parts.iter().map(|part| part.rays().len()).sum();
        match lower {
            Some(lower) => CpuStage::answer_together(parts, |rays, answers| {
                lower.answer_batch(rays, &mut { pages }, answers);
            }),
            None if rays < PART_RAYS_MIN * parts.len() => {
                CpuStage::answer_together(parts, |rays, answers| {
                    upper.answer_batch(rays, |ray, answer| answers[ray] = answer);
                })
            }
            // A part at a time, where it lies: larger batches are no faster.
            None => {
                for part in parts {
                    let (rays, answers) = part.parts_mut();
                    upper.answer_batch(rays, |ray, answer| answers[ray] = answer);
                }
            }
        }
        GTurn::Answered(call)
    }
}

//! `ScalarStage`: the scalar walk as a G-stage, ray by ray: what lanes and devices are measured beside.
//!
//! Invariant: its answers are those of [`VoxelScene::answer`](trex_render::VoxelScene::answer) and
//! [`LowerScene::answer`](trex_render::LowerScene::answer).

use std::sync::Arc;
use trex_render::{CpuStage, GCall, GNeeds, GStage, GTurn, GUnits, Pages, Voxels};
use trex_store::Result;

/// The scalar walk.
#[derive(Debug, Default)]
pub(super) struct ScalarStage {
    voxels: Option<Arc<Voxels>>,
}

impl GStage for ScalarStage {
    fn set_octree(&mut self, octree: &Arc<Voxels>) -> Result<()> {
        self.voxels = Some(octree.clone());
        Ok(())
    }

    fn needs(&self) -> GNeeds {
        CpuStage::NEEDS
    }

    fn submit(&self, mut call: GCall, mut pages: &mut dyn Pages) -> GTurn {
        let voxels = self.voxels.as_deref().expect("the octree is set");
        let upper = voxels.scene(call.view.occluders);
        let lower = match call.view.units {
            GUnits::None => None,
            GUnits::On(missing) => {
                voxels.lower_scene(call.view.occluders).map(|lower| lower.on_missing(missing))
            }
        };
        for part in &mut call.parts {
            let (rays, answers) = part.parts_mut();
            for (ray, answer) in rays.iter().zip(answers) {
                *answer = match &lower {
                    Some(lower) => lower.answer(ray, &mut pages),
                    None => upper.answer(ray),
                };
            }
        }
        GTurn::Answered(call)
    }
}

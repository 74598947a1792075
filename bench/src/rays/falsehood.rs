//! How often a G-ray's answer is false: the same rays through the voxels and through the mesh.
//!
//! ```text
//! voxels hit, the mesh does not within the ray's length        false hit: a shadow or a dark corner too much
//! the mesh is hit, the voxels are not                          false miss: light where none can come
//! both, more than two leaves from each other                   far hit: light of another place
//! ```
//!
//! Rays begin where they do in pictures, free of their own surface's voxels; what stands nearer than that is a miss
//! of both.

use super::contender::{Contender, RayAnswer};
use super::gray::Gray;
use super::sets::{Query, RaySet};
use serde::Serialize;

/// How far from each other two hits may lie, in leaves: a voxel is entered before its surface, and the next one may
/// be hit.
const NEAR_LEAVES: f64 = 2.0;

/// Shares of a set's rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct AgainstMesh {
    /// Of all rays, hits where the mesh has none.
    pub false_hit_share: f64,
    /// Of all rays, misses where the mesh has a hit.
    pub false_miss_share: f64,
    /// Of the rays that hit both, those more than two leaves apart; `None` where nearness was not asked.
    pub far_hit_share: Option<f64>,
}

/// Asks all rays of `set` of both, and compares.
pub(super) fn against(mesh: &mut dyn Contender, gray: &mut Gray<'_>, set: &RaySet) -> AgainstMesh {
    let mut exact = vec![RayAnswer::NONE; set.rays.len()];
    let mut voxel = exact.clone();
    mesh.trace(set, &mut exact);
    gray.trace(set, &mut voxel);
    // The mesh tells distances in lengths of the direction, voxels in model units.
    for (answer, ray) in exact.iter_mut().zip(&set.rays) {
        let direction = gray.space.to_model(ray).direction;
        answer.t *= direction.iter().map(|d| d * d).sum::<f64>().sqrt() as f32;
    }
    let near = NEAR_LEAVES * gray.scene.leaf_side();
    shares(&exact, &voxel, (set.query == Query::Closest).then_some(near))
}

/// Compares answers whose distances are in the same units; hits are far from each other beyond `near`.
fn shares(exact: &[RayAnswer], voxel: &[RayAnswer], near: Option<f64>) -> AgainstMesh {
    let share = |part: usize, of: usize| part as f64 / of.max(1) as f64;
    let of_hits = |voxel_hits: bool, mesh_hits: bool| {
        let pairs = exact.iter().zip(voxel);
        pairs.filter(move |(mesh, voxel)| (voxel.is_hit(), mesh.is_hit()) == (voxel_hits, mesh_hits))
    };
    let far = |near: f64| {
        let apart = |(mesh, voxel): &(&RayAnswer, &RayAnswer)| f64::from((mesh.t - voxel.t).abs()) > near;
        share(of_hits(true, true).filter(apart).count(), of_hits(true, true).count())
    };
    AgainstMesh {
        false_hit_share: share(of_hits(true, false).count(), exact.len()),
        false_miss_share: share(of_hits(false, true).count(), exact.len()),
        far_hit_share: near.map(far),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_of_falsehood_is_counted() {
        let hit = |t: f32| RayAnswer { t, triangle: 7 };
        let exact =
            [hit(1.0), hit(1.0), hit(2.0), RayAnswer::NONE, RayAnswer::NONE, hit(5.0), hit(9.0), hit(3.0)];
        let voxel =
            [hit(1.4), hit(1.6), RayAnswer::NONE, hit(1.0), RayAnswer::NONE, hit(5.0), hit(2.0), hit(3.5)];
        let found = shares(&exact, &voxel, Some(0.5));
        let expected =
            AgainstMesh { false_hit_share: 0.125, false_miss_share: 0.125, far_hit_share: Some(0.4) };
        assert_eq!(found, expected);
        assert_eq!(shares(&exact, &voxel, None).far_hit_share, None);
        assert_eq!(shares(&[], &[], Some(1.0)).false_hit_share, 0.0);
    }
}

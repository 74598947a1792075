//! Rays that stand for cones: every stage answers them as single rays, and those as two rays, one after the other.

use crate::command::said;
use crate::g_stage::{settings, stages};
use crate::voxels_lower_batch::{PartialPages, all_there};
use trex_render::{Answer, GAnswer, GCall, GKind, GRays, GUnits, GView, MissingUnits, Occluders, Ray};
use trex_store::octree::Refinement;

/// A ray reads the finest voxels up to where its cone is as wide as a coarser one, and from there on those: the same as
/// two rays, one after the other. How many answers differ from those of a line is said.
#[test]
fn cones_read_coarser_voxels_where_they_are_wide() {
    let (settings, mut apart, mut all) = (settings(), 0, 0);
    let view = GView { occluders: Occluders::On, units: GUnits::On(MissingUnits::Block) };
    for (setting, refinement) in settings.iter().zip([Refinement::By16, Refinement::By4]) {
        let upper = setting.voxels.scene(Occluders::On);
        let lower = setting.voxels.lower_scene(Occluders::On).unwrap();
        let cone = |at: usize| ([0.0, 0.5, 2.0, 64.0][at % 4], [0.05, 0.3, 1.0][at % 3]);
        let asked = |at: usize, ray: &Ray| {
            let (ray, t_in) = lower.g_ray(ray, [GKind::Gather, GKind::Shadow][at % 5 / 4]);
            let (width, spread) = cone(at);
            (ray.with_cone(width, spread), t_in)
        };
        let mut rays = GRays::default();
        setting.rays.iter().enumerate().for_each(|(at, ray)| {
            rays.push(asked(at, ray).0);
        });
        let mut pages = PartialPages::new(&setting.all, all_there, usize::MAX);
        let singles: Vec<GAnswer> = rays.rays().iter().map(|ray| lower.answer(ray, &mut pages)).collect();
        for (name, stage) in stages() {
            let mut stage = stage();
            stage.set_octree(&setting.voxels).unwrap();
            for part in [rays.rays().len(), 3] {
                let parts = rays.rays().chunks(part).map(|rays| {
                    let mut part = GRays::default();
                    rays.iter().for_each(|ray| {
                        part.push(*ray);
                    });
                    part
                });
                let call = GCall { view, parts: parts.collect() };
                let found = stage.submit(call, &mut pages).wait();
                let answers = found.parts.iter().flat_map(|part| part.answers());
                assert!(answers.eq(&singles), "{name}: other answers than those of single rays");
            }
        }
        if refinement != Refinement::By4 {
            continue;
        }
        let mut off = 0;
        for (at, (ray, found)) in setting.rays.iter().zip(&singles).enumerate() {
            let (g_ray, t_in) = asked(at, ray);
            let cell = lower.subvoxel_side();
            let (t_max, reach) = (ray.t_max, t_in + f64::from(g_ray.reach(4.0)) * cell);
            let near = Ray { t_max: reach.min(t_max), ..*ray };
            let first = if reach > t_in { lower.intersect(&near, &mut pages) } else { Answer::Exact(None) };
            let Answer::Exact(first) = first else { panic!("all pages are there") };
            let t = first.map(|hit| hit.upper.t).or_else(|| {
                let rest = Ray {
                    origin: std::array::from_fn(|a| ray.origin[a] + reach * ray.direction[a]),
                    t_max: t_max - reach,
                    ..*ray
                };
                upper.intersect(&rest).filter(|_| reach <= t_max).map(|hit| hit.t + reach)
            });
            let t_found = (found.outcome == GAnswer::MET).then(|| t_in + f64::from(found.t) * cell);
            let is_shadow = g_ray.kind() == GKind::Shadow;
            off += usize::from(match (t_found, t) {
                (None, None) => false,
                (Some(_), Some(_)) if is_shadow => false,
                (Some(found), Some(t)) => (found - t).abs() > cell,
                _ => true,
            });
            let Answer::Exact(line) = lower.intersect(ray, &mut pages) else { panic!("all pages are there") };
            apart += usize::from(line.is_some() != t.is_some());
            all += 1;
        }
        assert!(off * 1000 <= setting.rays.len(), "{off} of {} rays", setting.rays.len());
    }
    said(&format!(
        "{apart} of {all} rays with cones meet something where lines meet nothing, or the other way"
    ));
    assert!(apart > 0 && apart * 8 < all, "{apart} of {all}");
}

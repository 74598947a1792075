//! Rays in packets give what single rays give.

use super::random_rays;
use crate::fixtures::model;
use std::collections::BTreeMap;
use trex_render::{AllResident, Answer, Hit, Page, PagedMesh, Pages, Ray, Tracer};

/// Rays in packets against the same rays one by one, in an order where neighbours go the same way, and in one where
/// they do not; with all pages, and with some that are not there.
#[test]
fn packets_answer_as_single_rays_do() {
    for spec in ["gen:isosurface:50k:4", "gen:pipes:50k:4"] {
        let built = model(spec);
        let resident = AllResident::load(&built.file);
        let mut rays = random_rays(&built, 4001, 5);
        // Bundles: nine rays around one, so that chunks of eight hold parts of two.
        let around = rays.clone().into_iter().enumerate().flat_map(|(i, ray)| {
            (0..9).map(move |k| {
                let tilt = 1e-3 * f64::from(k) * if i % 3 == 0 { 100.0 } else { 1.0 };
                let [x, y, z] = ray.direction;
                Ray { direction: [x + tilt * y, y - tilt * x, z + tilt * x], ..ray }
            })
        });
        rays.extend(around.collect::<Vec<_>>());
        // Ends before the first hit, and between two.
        for (i, ray) in rays.iter_mut().enumerate().skip(1).step_by(5) {
            ray.t_max = built.file.superblock().bounds.diagonal() * (i % 11) as f64 / 10.0;
        }
        for hidden in [u32::MAX, 3, 2] {
            let pages = || HiddenPages { resident: &resident, hidden, wanted: BTreeMap::new() };
            let [mut packets, mut singles] = [(); 2].map(|()| PagedMesh::new(&built.file, pages()));
            let (mut hits, mut occluded) = (Vec::new(), Vec::new());
            packets.intersect_coherent(&rays, &mut hits);
            packets.occluded_coherent(&rays, &mut occluded);
            let count = |answer: fn(&&Answer<Option<Hit>>) -> bool| hits.iter().filter(answer).count();
            let found = count(|hit| matches!(hit, Answer::Exact(Some(_))));
            let blocked = count(|hit| matches!(hit, Answer::Blocked));
            assert_eq!(blocked > rays.len() / 10, hidden < u32::MAX);
            // A hidden page around all others blocks every ray that meets anything.
            assert!(found > rays.len() / 2 || hidden < u32::MAX);
            for (ray, hit) in rays.iter().zip(&hits) {
                assert_eq!(*hit, singles.intersect(ray), "{spec}: {ray:?}");
            }
            for (ray, any) in rays.iter().zip(&occluded) {
                assert_eq!(*any, singles.occluded(ray), "{spec}: {ray:?}");
            }
            let [wanted, expected] = [&packets, &singles].map(|mesh| &mesh.pages().wanted);
            assert!(wanted == expected && wanted.is_empty() == (hidden == u32::MAX), "{spec}");
        }
    }
}

/// Pages of which every so many is missing.
struct HiddenPages<'a> {
    resident: &'a AllResident,
    hidden: u32,
    /// How many rays each page has blocked.
    wanted: BTreeMap<u32, u32>,
}

impl Pages for HiddenPages<'_> {
    fn page(&mut self, page: u32) -> Page<'_> {
        if page % self.hidden == self.hidden - 1 {
            Page::Missing
        } else {
            Page::Ready(self.resident.frame(page).into())
        }
    }

    fn want(&mut self, page: u32) {
        *self.wanted.entry(page).or_default() += 1;
    }
}

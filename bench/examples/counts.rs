//! One pass of a step of tracing or of install, for a tool that counts instructions: `bench/callgrind.sh` runs it.
//!
//! ```text
//! counts FILE alone|packets|shadow-alone|shadow-packets|install    ->  how many steps `measured` took, on stdout
//! ```
//!
//! Invariant: all that counts is called from [`measured`] and from nowhere else.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use trex_render::{AllResident, Answer, Camera, PagedMesh, Ray, Tracer};
use trex_store::layout::FRAME_BYTES;
use trex_store::pool::PageStore;
use trex_store::{Budget, PageFile};

/// Pixels along a side of the picture from which rays come.
const SIDE: u32 = 256;
/// Direction of shadow rays: of unit length, along no axis.
const SUN: [f64; 3] = [0.36, 0.8, 0.48];

/// What callgrind collects.
#[inline(never)]
fn measured(work: &mut dyn FnMut() -> u64) -> u64 {
    work()
}

/// From what `rays` meet, just off it, in one direction.
fn shadow_rays(file: &PageFile, mesh: &mut impl Tracer, rays: &[Ray]) -> Vec<Ray> {
    let off = 1e-6 * file.superblock().bounds.diagonal();
    let shadow = |ray: &Ray| {
        let Answer::Exact(Some(hit)) = mesh.intersect(ray) else { return None };
        let towards = (0..3).map(|a| f64::from(hit.normal[a]) * ray.direction[a]).sum::<f64>();
        let at = |a: usize| {
            ray.origin[a] + hit.t * ray.direction[a] - off * towards.signum() * f64::from(hit.normal[a])
        };
        Some(Ray { origin: [at(0), at(1), at(2)], direction: SUN, t_max: f64::INFINITY })
    };
    rays.iter().filter_map(shadow).collect()
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, step] = arguments.as_slice() else { panic!("usage: counts FILE STEP") };
    let file = Arc::new(PageFile::open(Path::new(path), &Budget::unlimited()).expect("a page file"));
    let pages = AllResident::load(&file);
    let camera = Camera::framing(&file.superblock().bounds, [SIDE; 2], None, None);
    let projection = camera.project([SIDE; 2]).expect("a picture");
    let pixels = (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| [x, y].map(|v| f64::from(v) + 0.5)));
    let rays: Vec<Ray> = pixels.map(|[x, y]| projection.ray(x, y)).collect();

    let mut mesh = PagedMesh::new(&file, &pages);
    let mut answers = Vec::with_capacity(rays.len());
    let steps = match step.as_str() {
        "alone" => measured(&mut || {
            answers.extend(rays.iter().map(|ray| mesh.intersect(ray)));
            answers.len() as u64
        }),
        "packets" => measured(&mut || {
            mesh.intersect_coherent(&rays, &mut answers);
            answers.len() as u64
        }),
        "shadow-alone" => {
            let shadows = shadow_rays(&file, &mut mesh, &rays);
            measured(&mut || {
                shadows.iter().map(|ray| u64::from(matches!(mesh.occluded(ray), Answer::Exact(_)))).sum()
            })
        }
        "shadow-packets" => {
            let (shadows, mut answers) =
                (shadow_rays(&file, &mut mesh, &rays), Vec::with_capacity(rays.len()));
            measured(&mut || {
                mesh.occluded_coherent(&shadows, &mut answers);
                answers.len() as u64
            })
        }
        "install" => {
            let bytes = std::fs::read(path).expect("the file");
            let (mut frame, mut scratch) = (vec![0; FRAME_BYTES], Vec::new());
            measured(&mut || {
                for page in 0..file.page_count() {
                    let extent = file.extent(page);
                    let stored = &bytes[extent.offset as usize..][..extent.stored_bytes as usize];
                    file.install(page, stored, &mut frame, &mut scratch).expect("a sound page");
                }
                file.superblock().triangle_count
            })
        }
        _ => panic!("no such step: {step}"),
    };
    writeln!(std::io::stdout(), "{steps}").expect("stdout takes a line");
}

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
use trex_bench::view_rays::{camera_rays, shadow_rays};
use trex_render::{AllResident, Answer, PagedMesh, Tracer};
use trex_store::layout::FRAME_BYTES;
use trex_store::pool::PageStore;
use trex_store::{Budget, PageFile};

/// Pixels along a side of the picture from which rays come.
const SIDE: u32 = 256;

/// What callgrind collects.
#[inline(never)]
fn measured(work: &mut dyn FnMut() -> u64) -> u64 {
    work()
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, step] = arguments.as_slice() else { panic!("usage: counts FILE STEP") };
    let file = Arc::new(PageFile::open(Path::new(path), &Budget::unlimited()).expect("a page file"));
    let pages = AllResident::load(&file);
    let rays = camera_rays(&file, SIDE);

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

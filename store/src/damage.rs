//! `DamageList`: the pages of a file that could not be read while it was shown, and what was drawn in their place.
//!
//! Invariants: 1. every damaged page that rays have asked for is counted; 2. the list is bounded, and its first pages
//! are the first that were met; 3. serialized, no page names a file: what goes wrong with it stays with its error.

use crate::layout::PageKind;
use crate::pool::PagePool;
use crate::verify::boxes_of;
use crate::{Aabb, Error, PageFile};
use serde::Serialize;

/// Most damaged pages that are listed one by one.
const LISTED_MAX: usize = 64;

/// What is damaged of a file on show, as far as rays have asked for it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct DamageList {
    /// All damaged pages.
    pub page_count: u64,
    /// The first of them, at most 64.
    pub pages: Vec<DamagedPage>,
}

/// A page that could not be read.
#[derive(Clone, Debug, Serialize)]
pub struct DamagedPage {
    /// Its number in the file.
    pub page: u32,
    /// What is shown in its place: `as empty`, `by coarser voxels`.
    pub drawn: &'static str,
    /// Where its triangles lie, model units; not known of pages of voxels.
    pub bounds: Option<Aabb>,
    /// The mismatch that was found, and its place in the file.
    #[serde(skip)]
    pub error: Error,
}

impl DamageList {
    /// The damage that `pool` has met in `file`.
    pub fn of(file: &PageFile, pool: &PagePool) -> DamageList {
        let page_count = pool.stats().damaged;
        if page_count == 0 {
            return DamageList::default();
        }
        let errors: Vec<_> = pool.damage().into_iter().take(LISTED_MAX).collect();
        let boxes = boxes_of(file, &errors.iter().map(|(page, _)| *page).collect());
        let pages = errors.into_iter().map(|(page, error)| DamagedPage {
            page,
            drawn: match file.pages()[page as usize].kind {
                PageKind::Mesh => "as empty",
                PageKind::Units => "by coarser voxels",
                PageKind::Colours => "without its colours",
                PageKind::Normals => "without its normals",
            },
            bounds: boxes.get(&page).copied(),
            error,
        });
        DamageList { page_count, pages: pages.collect() }
    }
}

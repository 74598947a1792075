//! `Damage`: the pages of a file that could not be read while it was shown, and what was drawn in their place.
//!
//! Invariants: 1. every damaged page that was asked for is counted; 2. the list is bounded, and its first pages are the
//! first that were met; 3. `render` and `view` report damage in these words.

use super::stage::Stage;
use crate::context::Context;
use serde::Serialize;
use std::fmt;
use trex_store::verify::boxes_of;
use trex_store::{Aabb, printable::one_line};

/// Most damaged pages that are listed one by one.
const LISTED_MAX: usize = 64;
/// Most damaged pages that are named on stderr.
const NAMED_MAX: usize = 10;

/// What is damaged of a file on show, as far as rays have asked for it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Damage {
    /// All damaged pages.
    pub page_count: u64,
    /// The first of them.
    pub pages: Vec<DamagedPage>,
}

/// A page that could not be read.
#[derive(Clone, Debug, Serialize)]
pub struct DamagedPage {
    pub page: u32,
    /// What is shown in its place: `as empty`, `by coarser voxels`.
    pub drawn: &'static str,
    /// Where its triangles lie, model units; not known of pages of voxels.
    pub bounds: Option<Aabb>,
    /// The mismatch that was found.
    pub what: String,
    /// The place of the page in the file.
    pub place: String,
}

impl Damage {
    /// The damage that the pool of `stage` has met.
    pub fn of(stage: &Stage) -> Damage {
        let page_count = stage.pool.stats().damaged;
        if page_count == 0 {
            return Damage::default();
        }
        let errors: Vec<_> = stage.pool.damage().into_iter().take(LISTED_MAX).collect();
        let boxes = boxes_of(stage.model.file(), &errors.iter().map(|(page, _)| *page).collect());
        let pages = errors.iter().map(|(page, error)| DamagedPage {
            page: *page,
            drawn: if stage.model.file().has_units(*page) { "by coarser voxels" } else { "as empty" },
            bounds: boxes.get(page).copied(),
            what: error.what().to_owned(),
            place: error.place().to_owned(),
        });
        Damage { page_count, pages: pages.collect() }
    }

    /// Names the first damaged pages on stderr.
    pub fn report(&self, ctx: &Context) {
        for page in self.pages.iter().take(NAMED_MAX) {
            ctx.console.note(&one_line(&page.to_string()));
        }
        let others = self.page_count.saturating_sub(NAMED_MAX as u64);
        if others > 0 {
            ctx.console.note(&format!("damaged pages beyond these: {others}; `trex verify` lists all"));
        }
    }
}

impl fmt::Display for DamagedPage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let DamagedPage { page, drawn, bounds, what, place } = self;
        write!(f, "damaged page {page}, drawn {drawn}: {what} {place}")?;
        if let Some(b) = bounds {
            write!(f, ", box {:?} to {:?}", b.lo, b.hi)?;
        }
        Ok(())
    }
}

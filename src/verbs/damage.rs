//! `Damage`: the pages of a file that could not be read while it was shown, in the words of `render` and `view`.
//!
//! Invariant: the first damaged pages are named one by one, and the others are counted.

use super::stage::Stage;
use crate::context::Context;
use serde::Serialize;
use std::fmt;
use trex_store::printable::one_line;
use trex_store::{DamageList, DamagedPage};

/// Most damaged pages that are named on stderr.
const NAMED_MAX: usize = 10;

/// What is damaged of a file on show, as far as rays have asked for it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Damage {
    /// All damaged pages.
    pub page_count: u64,
    /// The first of them.
    pub pages: Vec<PageDamage>,
}

/// A page that could not be read, and why.
#[derive(Clone, Debug, Serialize)]
pub struct PageDamage {
    #[serde(flatten)]
    page: DamagedPage,
    /// The mismatch that was found.
    what: String,
    /// The place of the page in the file.
    place: String,
}

impl Damage {
    /// The damage that the pool of `stage` has met.
    pub fn of(stage: &Stage) -> Damage {
        let DamageList { page_count, pages } = DamageList::of(stage.model.file(), &stage.pool);
        let named = |page: DamagedPage| {
            let (what, place) = (page.error.what().to_owned(), page.error.place().to_owned());
            PageDamage { page, what, place }
        };
        Damage { page_count, pages: pages.into_iter().map(named).collect() }
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

impl fmt::Display for PageDamage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let PageDamage { page: DamagedPage { page, drawn, bounds, .. }, what, place } = self;
        write!(f, "damaged page {page}, drawn {drawn}: {what} {place}")?;
        if let Some(b) = bounds {
            write!(f, ", box {:?} to {:?}", b.lo, b.hi)?;
        }
        Ok(())
    }
}

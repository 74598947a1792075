//! `UnitPages`: the pages of a tracer, for rays through the units of the lower octrees.

use super::{Page, Pages, Tracer};

/// Pages of units, looked up by a tracer.
pub(crate) struct UnitPages<'t, T>(pub(crate) &'t mut T);

impl<T: Tracer> Pages for UnitPages<'_, T> {
    #[inline]
    fn page(&mut self, page: u32) -> Page<'_> {
        self.0.unit_page(page)
    }

    fn hold(&self, page: u32) -> Option<Page<'_>> {
        self.0.hold_unit_page(page)
    }

    fn let_go(&mut self) {
        self.0.let_go_unit_pages();
    }

    fn want(&mut self, page: u32) {
        self.0.want_unit_page(page);
    }
}

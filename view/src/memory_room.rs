//! What memory the picture on show and what is beside it get: as it is planned, for frames of pages and for the light
//! of before alike.
//!
//! Invariant: light of before goes before frames come in its place, and comes after they have gone.

use crate::session_loop::SessionLoop;
use crate::state::{LimitText, State};
use crate::surroundings::Room;
use trex_render::{PagedTracer, RenderSettings};
use trex_store::Result;

impl<T: PagedTracer + Send> SessionLoop<'_, T> {
    /// The room for a picture on show, beside files that are not sent yet.
    pub(crate) fn room(&self, settings: RenderSettings) -> Room {
        Room::of(settings, self.session().view().parts.needs(), self.files.now())
    }

    /// Sets the memory for pages.
    pub(crate) fn set_limit(&mut self, bytes: u64) {
        self.fit_light(&[self.room(self.session().view().settings)], Some(bytes));
        let set = (self.around.set_limit)(bytes);
        self.fit_light_on_show();
        match set {
            Ok(()) => {
                let limit_bytes = self.around.budget.limit_bytes();
                let update = State { memory: Some(LimitText { limit_bytes }), ..State::default() };
                self.shared.send_state(update, None);
                self.send_stats();
            }
            Err(error) => self.send_error(&error),
        }
    }

    /// Sets the memory for frames of pages to what these leave, and for the light of before to what is planned.
    pub(crate) fn make_room(&mut self, rooms: &[Room]) -> Result<()> {
        self.fit_light(rooms, None);
        let made = (self.around.make_room)(rooms);
        match &made {
            Ok(()) => self.fit_light(rooms, None),
            Err(_) => self.fit_light_on_show(),
        }
        made
    }

    /// Keeps as much light of before as is planned beside each of these. What cannot be planned is refused by who makes
    /// room for it.
    pub(crate) fn fit_light(&mut self, rooms: &[Room], limit_bytes: Option<u64>) {
        if let Ok(bytes) = (self.around.kept_light)(rooms, limit_bytes) {
            self.session_mut().keep_light_within(bytes);
        }
    }

    pub(crate) fn fit_light_on_show(&mut self) {
        self.fit_light(&[self.room(self.session().view().settings)], None);
    }
}

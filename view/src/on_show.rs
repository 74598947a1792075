//! What is on show, as texts: for pages that copy them, and for who shows it again.
//!
//! Invariant: a text is of the view at that moment, with every event that was applied.

use crate::materials::fingerprint;
use crate::session_loop::SessionLoop;
use crate::state::TextsText;
use crate::surroundings::{Recipe, ServeReport};
use crate::texts;
use trex_render::PagedTracer;

/// Longest scene file that goes to every page, bytes; a longer one goes as a file to who asks for it.
const SCENE_BYTES_MAX: usize = 16 << 10;

impl<T: PagedTracer + Send> SessionLoop<'_, T> {
    /// The view as command line and, unless it is long, as scene.
    pub(crate) fn texts(&self) -> TextsText {
        let sources = self.text_sources();
        let scene_bytes = texts::scene_bytes(&sources);
        let scene = (scene_bytes <= SCENE_BYTES_MAX).then(|| texts::scene(&sources, scene_bytes));
        TextsText { command: (self.around.command_line)(&self.recipe()), scene, scene_bytes }
    }

    /// What texts are made of.
    pub(crate) fn text_sources(&self) -> texts::TextSources<'_> {
        let session = self.session();
        let (view, model) = (session.view(), session.model());
        texts::TextSources {
            model: self.around.model_path,
            camera: &view.camera,
            lights: &view.lights,
            materials: self.around.file_materials,
            edited: model,
            keys: &view.settings,
            parts: &view.parts,
        }
    }

    /// What was served, and what was on show last.
    pub(crate) fn report(&self) -> ServeReport {
        let sources = self.text_sources();
        ServeReport {
            events: self.figures.events,
            scene: Some(texts::scene(&sources, texts::scene_bytes(&sources))),
            is_as_opened: self.is_lit_as_opened(),
            are_parts_edited: self.are_parts_edited,
            ..self.served.clone()
        }
    }

    /// True when lights and materials are those of what was opened.
    fn is_lit_as_opened(&self) -> bool {
        let session = self.session();
        session.view().lights == self.input_lights
            && fingerprint(&session.model().materials) == self.input_fingerprint
    }

    /// What makes the picture on show.
    fn recipe(&self) -> Recipe<'_> {
        let view = self.session().view();
        if self.is_lit_as_opened() && self.was_whole && view.parts.is_whole() {
            Recipe::Opened { camera: &view.camera, keys: &view.settings }
        } else {
            Recipe::Saved
        }
    }
}

//! `Mail`: what clients want of the session, as it waits and is handed out.
//!
//! Invariant: it never grows past its bounds, in pieces and in [`MAILBOX_BYTES`]: what does not fit is refused.

use crate::materials::{ListWish, NAME_BYTES_MAX};
use crate::message::{CameraText, Format, FromClient};
use crate::parts::PartsWish;
use crate::wire::LIGHTS_MAX;
use std::collections::VecDeque;
use std::time::Instant;
use trex_render::{MaterialEdit, RenderEdit};

/// Most edits that wait.
pub(crate) const EDITS_MAX: usize = 64;
/// Most questions that wait for an answer.
pub(crate) const QUESTIONS_MAX: usize = 64;
/// Most screenshots that wait, each of which takes seconds.
pub(crate) const SHOTS_MAX: usize = 4;
/// Bytes of what waits, at most: edits with the lights and the parts of one each, questions with the longest names,
/// and twice that while it is handed out.
pub(crate) const MAILBOX_BYTES: usize = 2
    * (EDITS_MAX * size_of::<Edit>()
        + 2 * LIGHTS_MAX * size_of::<trex_render::Light>()
        + 2 * PartsWish::BYTES_MAX
        + QUESTIONS_MAX * (size_of::<(ClientId, Question)>() + NAME_BYTES_MAX));

/// A client, by its number.
pub(crate) type ClientId = u32;

/// A change that is applied in order with others.
#[derive(Clone, Debug)]
pub(crate) enum Edit {
    Lights(Vec<trex_render::Light>),
    Material(usize, MaterialEdit),
    Settings(RenderEdit),
    Parts(PartsWish),
    /// Pixels from one to the next while the picture moves.
    Moving(u32),
}

/// Something that any page may ask, and that changes nothing.
#[derive(Clone, Debug)]
pub(crate) enum Question {
    /// What is at a pixel?
    Pick { id: u32, pixel: [u32; 2] },
    /// A part of the list of materials.
    Materials(ListWish),
    /// The scene's text as a file, of this number.
    Scene(u32),
}

/// A picture to be made into a file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shot {
    pub(crate) client: ClientId,
    pub(crate) id: u32,
    pub(crate) format: Format,
    pub(crate) size: [u32; 2],
    pub(crate) spp: u32,
}

/// All that came since the last time.
#[derive(Debug, Default)]
pub(crate) struct Mail {
    pub(crate) camera: Option<CameraText>,
    pub(crate) size: Option<[u32; 2]>,
    pub(crate) limit_bytes: Option<u64>,
    pub(crate) edits: VecDeque<Edit>,
    pub(crate) questions: VecDeque<(ClientId, Question)>,
    /// Until [`Mailbox::end_shot`] it is the one under way.
    pub(crate) shot: Option<Shot>,
    /// The last event of the driver.
    pub(crate) seq: Option<u32>,
    /// Who has sent the events; `None` where several have, one after the other.
    pub(crate) author: Option<ClientId>,
    pub(crate) rest: bool,
    /// Clients have come or gone, or another drives.
    pub(crate) roles: bool,
    /// When the oldest of it came.
    pub(crate) since: Option<Instant>,
}

/// The answer to a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PostOutcome {
    Accepted,
    /// Who watches does not change things.
    Watching,
    /// Too many wait.
    Full,
    /// Somebody else drives, and is not idle.
    Driven,
    /// A screenshot that waited waits no more.
    Cancelled,
}

impl Mail {
    /// Adds an event of `client`, who drives.
    pub(crate) fn add_event(&mut self, client: ClientId, message: FromClient) -> PostOutcome {
        let (seq, posted) = match message {
            FromClient::Camera { seq, position, target, up, fov_y } => {
                self.camera = Some(CameraText { position, target, up, fov_y });
                (Some(seq), PostOutcome::Accepted)
            }
            FromClient::Size { seq, size } => {
                self.size = Some(size);
                (Some(seq), PostOutcome::Accepted)
            }
            FromClient::Limit { seq, bytes } => {
                self.limit_bytes = Some(bytes);
                (Some(seq), PostOutcome::Accepted)
            }
            FromClient::Rest {} => {
                self.rest = true;
                (None, PostOutcome::Accepted)
            }
            FromClient::Lights { seq, lights } => (Some(seq), self.push_edit(Edit::Lights(lights))),
            FromClient::Material { seq, index, edit } => {
                (Some(seq), self.push_edit(Edit::Material(index, edit)))
            }
            FromClient::Settings { seq, settings } => (Some(seq), self.push_edit(Edit::Settings(settings))),
            FromClient::Parts { seq, parts } => (Some(seq), self.push_edit(Edit::Parts(parts))),
            FromClient::Moving { scale } => (None, self.push_edit(Edit::Moving(scale))),
            // These are no events.
            FromClient::Hello { .. } | FromClient::Ack { .. } | FromClient::Drive {} => {
                (None, PostOutcome::Accepted)
            }
            FromClient::Pick { .. } | FromClient::Materials { .. } | FromClient::Scene { .. } => {
                (None, PostOutcome::Accepted)
            }
            FromClient::Screenshot { .. } | FromClient::Cancel { .. } => (None, PostOutcome::Accepted),
        };
        if posted == PostOutcome::Accepted && seq.is_some() {
            let is_first = self.seq.is_none();
            self.author = Some(client).filter(|_| is_first || self.author == Some(client));
            self.seq = seq;
        }
        posted
    }

    /// Adds a question. Of parts of the list of materials a page wants the last that it asked for.
    pub(crate) fn ask(&mut self, client: ClientId, question: Question) -> PostOutcome {
        if matches!(question, Question::Materials(_)) {
            self.questions.retain(|(from, old)| *from != client || !matches!(old, Question::Materials(_)));
        }
        push(&mut self.questions, QUESTIONS_MAX, (client, question))
    }

    /// All lights come each time, and all sections, and nothing else depends on them: the latest take the place of
    /// those that wait.
    fn push_edit(&mut self, edit: Edit) -> PostOutcome {
        let is_whole = matches!(edit, Edit::Lights(_) | Edit::Parts(_));
        let is_alike = |other: &Edit| std::mem::discriminant(other) == std::mem::discriminant(&edit);
        match (self.edits.iter_mut().find(|other| is_whole && is_alike(other)), edit) {
            (Some(Edit::Parts(waiting)), Edit::Parts(wish)) => wish.replace(waiting),
            (Some(waiting), edit) => *waiting = edit,
            (None, edit) => return push(&mut self.edits, EDITS_MAX, edit),
        }
        PostOutcome::Accepted
    }
}

/// Adds to a queue of at most so many.
pub(crate) fn push<T>(queue: &mut VecDeque<T>, most: usize, item: T) -> PostOutcome {
    if queue.len() >= most {
        return PostOutcome::Full;
    }
    queue.push_back(item);
    PostOutcome::Accepted
}

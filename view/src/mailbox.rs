//! `Mailbox`: what clients want of the session, from the threads that read sockets to the one that renders.
//!
//! ```text
//! camera, size, limit     the latest counts
//! edits                   in order, at most 64; of lights the latest alone
//! questions               in order, few; of parts of the list of materials a page's latest alone
//! screenshots             in order, few; one is handed out at a time, and is wanted until its page goes or cancels it
//! ```
//!
//! One client drives, the others watch. Who drives is decided here, so that no watcher's event gets further.
//!
//! Invariants: 1. it never grows past its bounds: what does not fit is refused, and who sent it is told; 2. events are
//! of the one who drives; 3. `has_event` is true exactly while there is something to take; 4. a screenshot of a page that
//! has gone is not wanted.

use crate::materials::{ListWish, cut};
use crate::message::{CameraText, Format, FromClient, LIGHTS_MAX, Role};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use trex_render::{MaterialEdit, RenderEdit};

/// Most edits that wait.
const EDITS_MAX: usize = 64;
/// Most questions that wait for an answer.
const QUESTIONS_MAX: usize = 64;
/// Most screenshots that wait, each of which takes seconds.
const SHOTS_MAX: usize = 4;
/// Who has not sent a thing for so long loses the wheel to whom asks for it.
const WHEEL_IDLE: Duration = Duration::from_secs(10);

/// Bytes of what waits, at most: edits with the lights of one of them, questions with the longest names, and twice that
/// while it is handed out.
pub(crate) const MAILBOX_BYTES: usize = 2
    * (EDITS_MAX * size_of::<Edit>()
        + 2 * LIGHTS_MAX * size_of::<trex_render::Light>()
        + QUESTIONS_MAX * (size_of::<(ClientId, Question)>() + 256));

/// A client, by its number.
pub(crate) type ClientId = u32;

/// A change that is applied in order with others.
#[derive(Clone, Debug)]
pub(crate) enum Edit {
    Lights(Vec<trex_render::Light>),
    Material(usize, MaterialEdit),
    Settings(RenderEdit),
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
    pub(crate) rest: bool,
    /// Clients have come or gone, or another drives.
    pub(crate) roles: bool,
    /// When the oldest of it came.
    pub(crate) since: Option<Instant>,
}

/// The answer to a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Posted {
    Taken,
    /// Who watches does not change things.
    Watching,
    /// Too many wait.
    Full,
    /// Somebody else drives, and is not idle.
    Driven,
    /// A screenshot that waited waits no more.
    Cancelled,
}

/// See the module's description.
#[derive(Debug, Default)]
pub(crate) struct Mailbox {
    inner: Mutex<Inner>,
    bell: Condvar,
    has_event: AtomicBool,
    /// The screenshot under way is wanted; asked by many threads.
    is_shot_wanted: AtomicBool,
}

#[derive(Debug, Default)]
struct Inner {
    mail: Mail,
    /// Screenshots that wait.
    shots: VecDeque<Shot>,
    /// Client and number of the screenshot under way.
    under_way: Option<(ClientId, u32)>,
    driver: Option<ClientId>,
    /// When the driver was heard last.
    heard: Option<Instant>,
}

impl Mailbox {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().expect("a thread of the viewer panicked")
    }

    fn ring(&self, mut inner: MutexGuard<'_, Inner>) {
        inner.mail.since.get_or_insert_with(Instant::now);
        self.has_event.store(true, Ordering::Release);
        drop(inner);
        self.bell.notify_one();
    }

    /// A client has come, with a page of `size` pixels: it drives where nobody does.
    pub(crate) fn join(&self, client: ClientId, size: [u32; 2]) {
        let mut inner = self.lock();
        if inner.driver.is_none() {
            (inner.driver, inner.heard) = (Some(client), Some(Instant::now()));
            inner.mail.size = Some(size);
        }
        inner.mail.roles = true;
        self.ring(inner);
    }

    /// A client has gone.
    pub(crate) fn leave(&self, client: ClientId) {
        let mut inner = self.lock();
        if inner.driver == Some(client) {
            inner.driver = None;
        }
        inner.mail.questions.retain(|(from, _)| *from != client);
        inner.shots.retain(|shot| shot.client != client);
        if inner.under_way.is_some_and(|(of, _)| of == client) {
            self.is_shot_wanted.store(false, Ordering::Release);
        }
        inner.mail.roles = true;
        self.ring(inner);
    }

    /// What a client does.
    pub(crate) fn role(&self, client: ClientId) -> Role {
        if self.lock().driver == Some(client) { Role::Drive } else { Role::Watch }
    }

    /// The one who drives.
    pub(crate) fn driver(&self) -> Option<ClientId> {
        self.lock().driver
    }

    /// Takes a message of a client.
    pub(crate) fn post(&self, client: ClientId, message: FromClient) -> Posted {
        let mut inner = self.lock();
        let drives = inner.driver == Some(client);
        if drives {
            inner.heard = Some(Instant::now());
        }
        let posted = match message {
            FromClient::Drive {} => inner.give_wheel(client),
            FromClient::Cancel { id } => self.cancel(&mut inner, client, id),
            FromClient::Screenshot { id, format, size, spp } if drives => {
                push(&mut inner.shots, SHOTS_MAX, Shot { client, id, format, size, spp })
            }
            FromClient::Pick { id, pixel } => inner.mail.ask(client, Question::Pick { id, pixel }),
            FromClient::Materials { id, find, from, index } => {
                let find = cut(&find).to_owned();
                inner.mail.ask(client, Question::Materials(ListWish { id, find, from, index }))
            }
            FromClient::Scene { id } => inner.mail.ask(client, Question::Scene(id)),
            _ if !drives => Posted::Watching,
            message => inner.mail.add_event(message),
        };
        if posted == Posted::Taken {
            self.ring(inner);
        }
        posted
    }

    /// True while there is something to take.
    pub(crate) fn has_event(&self) -> bool {
        self.has_event.load(Ordering::Acquire)
    }

    /// Hands out all there is, but of screenshots the first alone.
    pub(crate) fn collect(&self) -> Mail {
        let mut inner = self.lock();
        let shot = inner.shots.pop_front();
        if let Some(shot) = &shot {
            inner.under_way = Some((shot.client, shot.id));
            self.is_shot_wanted.store(true, Ordering::Release);
        }
        self.has_event.store(!inner.shots.is_empty(), Ordering::Release);
        Mail { shot, ..std::mem::take(&mut inner.mail) }
    }

    /// True once after clients have come or gone, or another drives; all else stays.
    pub(crate) fn collect_roles(&self) -> bool {
        std::mem::take(&mut self.lock().mail.roles)
    }

    /// True while the screenshot under way is wanted.
    pub(crate) fn wants_shot(&self) -> bool {
        self.is_shot_wanted.load(Ordering::Acquire)
    }

    /// No screenshot is under way any more. True when it was wanted to its end.
    pub(crate) fn end_shot(&self) -> bool {
        self.lock().under_way = None;
        self.is_shot_wanted.swap(false, Ordering::AcqRel)
    }

    fn cancel(&self, inner: &mut Inner, client: ClientId, id: u32) -> Posted {
        if inner.under_way == Some((client, id)) {
            self.is_shot_wanted.store(false, Ordering::Release);
        }
        let count = inner.shots.len();
        inner.shots.retain(|shot| (shot.client, shot.id) != (client, id));
        if inner.shots.len() < count { Posted::Cancelled } else { Posted::Taken }
    }

    /// Waits until there is something to take, or `longest` has passed.
    pub(crate) fn wait(&self, longest: Duration) {
        let waits = |_: &mut Inner| !self.has_event();
        let _ = self.bell.wait_timeout_while(self.lock(), longest, waits);
    }
}

impl Inner {
    fn give_wheel(&mut self, client: ClientId) -> Posted {
        let is_idle = self.heard.is_none_or(|heard| heard.elapsed() >= WHEEL_IDLE);
        if self.driver.is_some_and(|driver| driver != client) && !is_idle {
            return Posted::Driven;
        }
        (self.driver, self.heard) = (Some(client), Some(Instant::now()));
        self.mail.roles = true;
        Posted::Taken
    }
}

impl Mail {
    /// Adds an event of the one who drives.
    fn add_event(&mut self, message: FromClient) -> Posted {
        let (seq, posted) = match message {
            FromClient::Camera { seq, position, target, up, fov_y } => {
                self.camera = Some(CameraText { position, target, up, fov_y });
                (Some(seq), Posted::Taken)
            }
            FromClient::Size { seq, size } => {
                self.size = Some(size);
                (Some(seq), Posted::Taken)
            }
            FromClient::Limit { seq, bytes } => {
                self.limit_bytes = Some(bytes);
                (Some(seq), Posted::Taken)
            }
            FromClient::Rest {} => {
                self.rest = true;
                (None, Posted::Taken)
            }
            FromClient::Lights { seq, lights } => (Some(seq), self.push_edit(Edit::Lights(lights))),
            FromClient::Material { seq, index, edit } => {
                (Some(seq), self.push_edit(Edit::Material(index, edit)))
            }
            FromClient::Settings { seq, settings } => (Some(seq), self.push_edit(Edit::Settings(settings))),
            FromClient::Moving { scale } => (None, self.push_edit(Edit::Moving(scale))),
            // These are no events.
            FromClient::Hello { .. } | FromClient::Ack { .. } | FromClient::Drive {} => (None, Posted::Taken),
            FromClient::Pick { .. } | FromClient::Materials { .. } | FromClient::Scene { .. } => {
                (None, Posted::Taken)
            }
            FromClient::Screenshot { .. } | FromClient::Cancel { .. } => (None, Posted::Taken),
        };
        if posted == Posted::Taken {
            self.seq = seq.or(self.seq);
        }
        posted
    }

    /// Adds a question. Of parts of the list of materials a page wants the last that it asked for.
    fn ask(&mut self, client: ClientId, question: Question) -> Posted {
        if matches!(question, Question::Materials(_)) {
            self.questions.retain(|(from, old)| *from != client || !matches!(old, Question::Materials(_)));
        }
        push(&mut self.questions, QUESTIONS_MAX, (client, question))
    }

    /// All lights come each time, and nothing else depends on them: the latest take the place of those that wait.
    fn push_edit(&mut self, edit: Edit) -> Posted {
        let is_lights = |edit: &Edit| matches!(edit, Edit::Lights(_));
        if is_lights(&edit)
            && let Some(waiting) = self.edits.iter_mut().find(|edit| is_lights(edit))
        {
            *waiting = edit;
            return Posted::Taken;
        }
        push(&mut self.edits, EDITS_MAX, edit)
    }
}

fn push<T>(queue: &mut VecDeque<T>, most: usize, item: T) -> Posted {
    if queue.len() >= most {
        return Posted::Full;
    }
    queue.push_back(item);
    Posted::Taken
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> FromClient {
        serde_json::from_str(text).unwrap()
    }

    fn camera(seq: u32) -> FromClient {
        message(&format!(
            r#"{{"type":"camera","seq":{seq},"position":[{seq},0,0],"target":[0,0,0],"up":[0,1,0],"fov_y":40}}"#
        ))
    }

    fn material(seq: u32) -> FromClient {
        message(&format!(r#"{{"type":"material","seq":{seq},"index":{seq},"edit":{{}}}}"#))
    }

    #[test]
    fn the_latest_camera_counts_and_edits_stay_in_order() {
        let mailbox = Mailbox::default();
        mailbox.join(1, [64, 64]);
        assert!(mailbox.has_event());
        for seq in 0..10 {
            assert_eq!(mailbox.post(1, camera(2 * seq)), Posted::Taken);
            assert_eq!(mailbox.post(1, material(2 * seq + 1)), Posted::Taken);
        }
        let mail = mailbox.collect();
        assert!(!mailbox.has_event() && mail.roles && mail.since.is_some());
        assert_eq!(mail.camera.unwrap().camera().position, [18.0, 0.0, 0.0]);
        assert_eq!((mail.seq, mail.size), (Some(19), Some([64, 64])));
        let order: Vec<usize> = mail.edits.iter().map(edit_index).collect();
        assert_eq!(order, (0..10).map(|seq| 2 * seq + 1).collect::<Vec<_>>());
    }

    fn edit_index(edit: &Edit) -> usize {
        let Edit::Material(index, _) = edit else { panic!("not of a material") };
        *index
    }

    #[test]
    fn past_its_bounds_it_refuses() {
        let mailbox = Mailbox::default();
        mailbox.join(1, [64, 64]);
        let pick = || message(r#"{"type":"pick","id":9,"pixel":[3,4]}"#);
        let shot = || message(r#"{"type":"screenshot","id":9,"format":"exr","size":[64,64],"spp":4}"#);
        for (most, make) in
            [(EDITS_MAX, &(|| material(3)) as &dyn Fn() -> FromClient), (QUESTIONS_MAX, &pick)]
        {
            (0..most).for_each(|_| assert_eq!(mailbox.post(1, make()), Posted::Taken));
            assert_eq!(mailbox.post(1, make()), Posted::Full);
        }
        (0..SHOTS_MAX).for_each(|_| assert_eq!(mailbox.post(1, shot()), Posted::Taken));
        assert_eq!(mailbox.post(1, shot()), Posted::Full);
        assert_eq!(mailbox.collect().edits.len(), EDITS_MAX);
        assert_eq!(mailbox.post(1, material(3)), Posted::Taken);
        // What was asked by who has gone is for nobody.
        mailbox.leave(1);
        assert!(mailbox.collect().shot.is_none() && !mailbox.has_event());
    }

    /// The lights of 64 messages that alternated with other edits waited all at once: megabytes that nobody had leased.
    #[test]
    fn of_lights_the_latest_wait_alone() {
        let mailbox = Mailbox::default();
        mailbox.join(1, [64, 64]);
        for seq in 0..20 {
            let lights = format!(
                r#"{{"type":"lights","seq":{seq},"lights":[{{"type":"sky","radiance":[{seq},0,0]}}]}}"#
            );
            assert_eq!(mailbox.post(1, message(&lights)), Posted::Taken);
            assert_eq!(mailbox.post(1, material(seq)), Posted::Taken);
        }
        let edits = mailbox.collect().edits;
        assert_eq!(edits.len(), 21);
        assert!(matches!(&edits[0], Edit::Lights(lights)
            if lights[..] == [trex_render::Light::Sky { radiance: [19.0, 0.0, 0.0] }]));
    }

    /// Who types into the search asks for the list with each letter.
    #[test]
    fn of_lists_a_page_gets_the_last_that_it_asked_for() {
        let mailbox = Mailbox::default();
        for (client, find) in [(1, "b"), (2, "bo"), (1, "bol"), (1, &"x".repeat(60_000))] {
            let text = format!(r#"{{"type":"materials","id":3,"find":"{find}"}}"#);
            assert_eq!(mailbox.post(client, message(&text)), Posted::Taken);
        }
        let waiting: Vec<_> = mailbox.collect().questions.into_iter().collect();
        let [(2, Question::Materials(second)), (1, Question::Materials(first))] = &waiting[..] else {
            panic!("{waiting:?}")
        };
        assert_eq!((second.find.as_str(), second.from, second.index), ("bo", 0, None));
        assert_eq!(first.find, "x".repeat(255));
    }

    /// One goes out at a time, so that all others can still be withdrawn; a page that cancels its own, or goes, makes
    /// the one under way unwanted, and no other page does.
    #[test]
    fn a_screenshot_is_wanted_until_its_page_goes_or_cancels_it() {
        let mailbox = Mailbox::default();
        mailbox.join(1, [64, 64]);
        mailbox.join(2, [64, 64]);
        let say = |client: ClientId, id: u32, text: &str| {
            mailbox.post(client, message(&text.replace("ID", &id.to_string())))
        };
        let shot = r#"{"type":"screenshot","id":ID,"format":"png","size":[64,64],"spp":4}"#;
        let cancel = r#"{"type":"cancel","id":ID}"#;
        assert_eq!(say(2, 1, shot), Posted::Watching);
        (1..=4).for_each(|id| assert_eq!(say(1, id, shot), Posted::Taken));
        assert_eq!(mailbox.collect().shot.unwrap().id, 1);
        assert!(mailbox.wants_shot() && mailbox.has_event());
        assert_eq!((say(2, 1, cancel), say(1, 2, cancel)), (Posted::Taken, Posted::Cancelled));
        assert!(mailbox.wants_shot());
        assert_eq!(say(1, 1, cancel), Posted::Taken);
        assert!(!mailbox.wants_shot() && !mailbox.end_shot());
        assert_eq!(mailbox.collect().shot.unwrap().id, 3);
        mailbox.leave(1);
        assert!(!mailbox.wants_shot() && mailbox.collect_roles() && !mailbox.collect_roles());
        assert!(!mailbox.end_shot() && mailbox.collect().shot.is_none());
    }

    #[test]
    fn one_drives_and_the_others_watch() {
        let mailbox = Mailbox::default();
        mailbox.join(1, [64, 64]);
        mailbox.join(2, [32, 32]);
        assert_eq!((mailbox.role(1), mailbox.role(2)), (Role::Drive, Role::Watch));
        assert_eq!(mailbox.collect().size, Some([64, 64]));
        assert_eq!(mailbox.post(2, camera(1)), Posted::Watching);
        assert!(!mailbox.has_event());
        assert_eq!(mailbox.post(2, FromClient::Drive {}), Posted::Driven);
        // Who has been idle for long enough.
        mailbox.lock().heard = Instant::now().checked_sub(WHEEL_IDLE);
        assert_eq!(mailbox.post(2, FromClient::Drive {}), Posted::Taken);
        assert_eq!((mailbox.role(1), mailbox.role(2)), (Role::Watch, Role::Drive));
        mailbox.leave(2);
        assert_eq!(mailbox.driver(), None);
        mailbox.join(3, [1, 1]);
        assert_eq!(mailbox.driver(), Some(3));
    }

    #[test]
    fn waiting_ends_with_an_event_or_its_time() {
        let mailbox = Mailbox::default();
        mailbox.wait(Duration::from_millis(1));
        std::thread::scope(|scope| {
            scope.spawn(|| mailbox.join(1, [1, 1]));
            let begin = Instant::now();
            mailbox.wait(Duration::from_secs(60));
            assert!(begin.elapsed() < Duration::from_secs(30) && mailbox.has_event());
        });
    }
}

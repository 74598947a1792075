//! `Mailbox`: what clients want of the session, from the threads that read sockets to the one that renders.
//!
//! ```text
//! camera, size, limit     the latest counts
//! edits                   in order, at most 64
//! picks, screenshots      in order, few
//! ```
//!
//! One client drives, the others watch. Who drives is decided here, so that no watcher's event gets further.
//!
//! Invariants: 1. it never grows past its bounds: what does not fit is refused, and who sent it is told; 2. events are
//! of the one who drives; 3. `has_event` is true exactly while there is something to take.

use crate::message::{CameraText, Format, FromClient, Role};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use trex_render::{MaterialEdit, RenderEdit};

/// Most edits that wait.
const EDITS_MAX: usize = 64;
/// Most pixels that wait to be looked at.
const PICKS_MAX: usize = 64;
/// Most screenshots that wait, each of which takes seconds.
const SCREENSHOTS_MAX: usize = 4;
/// Who has not sent a thing for so long loses the wheel to whom asks for it.
const WHEEL_IDLE: Duration = Duration::from_secs(10);

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
    pub(crate) picks: VecDeque<(ClientId, u32, [u32; 2])>,
    pub(crate) screenshots: VecDeque<Shot>,
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
}

/// See the module's description.
#[derive(Debug, Default)]
pub(crate) struct Mailbox {
    inner: Mutex<Inner>,
    bell: Condvar,
    has_event: AtomicBool,
}

#[derive(Debug, Default)]
struct Inner {
    mail: Mail,
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
        inner.mail.picks.retain(|(from, ..)| *from != client);
        inner.mail.screenshots.retain(|shot| shot.client != client);
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
            FromClient::Pick { id, pixel } => push(&mut inner.mail.picks, PICKS_MAX, (client, id, pixel)),
            _ if !drives => Posted::Watching,
            message => inner.mail.take_event(client, message),
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

    /// Takes all there is.
    pub(crate) fn take(&self) -> Mail {
        let mut inner = self.lock();
        self.has_event.store(false, Ordering::Release);
        std::mem::take(&mut inner.mail)
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
    /// Takes an event of the one who drives.
    fn take_event(&mut self, client: ClientId, message: FromClient) -> Posted {
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
            FromClient::Screenshot { id, format, size, spp } => {
                let shot = Shot { client, id, format, size, spp };
                (None, push(&mut self.screenshots, SCREENSHOTS_MAX, shot))
            }
            // These are no events.
            FromClient::Hello { .. } | FromClient::Ack { .. } => (None, Posted::Taken),
            FromClient::Pick { .. } | FromClient::Drive {} => (None, Posted::Taken),
        };
        if posted == Posted::Taken {
            self.seq = seq.or(self.seq);
        }
        posted
    }

    /// Edits of one kind that follow each other are as good as the last: all lights come each time.
    fn push_edit(&mut self, edit: Edit) -> Posted {
        if let (Some(last @ Edit::Lights(_)), Edit::Lights(_)) = (self.edits.back_mut(), &edit) {
            *last = edit;
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
        let mail = mailbox.take();
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
        for (most, make) in [(EDITS_MAX, &(|| material(3)) as &dyn Fn() -> FromClient), (PICKS_MAX, &pick)] {
            (0..most).for_each(|_| assert_eq!(mailbox.post(1, make()), Posted::Taken));
            assert_eq!(mailbox.post(1, make()), Posted::Full);
        }
        (0..SCREENSHOTS_MAX).for_each(|_| assert_eq!(mailbox.post(1, shot()), Posted::Taken));
        assert_eq!(mailbox.post(1, shot()), Posted::Full);
        assert_eq!(mailbox.take().edits.len(), EDITS_MAX);
        assert_eq!(mailbox.post(1, material(3)), Posted::Taken);
        // What was asked by who has gone is for nobody.
        mailbox.post(1, shot());
        mailbox.leave(1);
        assert!(mailbox.take().screenshots.is_empty());
    }

    #[test]
    fn one_drives_and_the_others_watch() {
        let mailbox = Mailbox::default();
        mailbox.join(1, [64, 64]);
        mailbox.join(2, [32, 32]);
        assert_eq!((mailbox.role(1), mailbox.role(2)), (Role::Drive, Role::Watch));
        assert_eq!(mailbox.take().size, Some([64, 64]));
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

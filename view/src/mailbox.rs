//! `Mailbox`: what clients want of the session, from the threads that read sockets to the one that renders.
//!
//! ```text
//! camera, size, limit     the latest counts
//! edits                   in order, at most 64; of lights, and of parts, the latest alone
//! questions               in order, few; of parts of the list of materials a page's latest alone
//! screenshots             in order, few; one is handed out at a time, and is wanted until its page goes or cancels it
//! ```
//!
//! One client drives, the others watch. Who drives is decided here, so that no watcher's event gets further.
//!
//! Invariants: 1. it never grows past its bounds: what does not fit is refused, and who sent it is told; 2. events are
//! of the one who drives; 3. `has_event` is true exactly while there is something to take; 4. a screenshot of a page
//! that has gone is not wanted.

use crate::mail::{ClientId, Mail, PostOutcome, Question, SHOTS_MAX, Shot, push};
use crate::materials::{ListWish, cut};
use crate::message::{FromClient, Role};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// Who has not sent a thing for so long loses the wheel to whom asks for it.
const WHEEL_IDLE: Duration = Duration::from_secs(10);

/// See the module's description.
#[derive(Debug, Default)]
pub(crate) struct Mailbox {
    inner: Mutex<MailboxState>,
    bell: Condvar,
    has_event: AtomicBool,
    /// The screenshot under way is wanted; asked by many threads.
    is_shot_wanted: AtomicBool,
}

#[derive(Debug, Default)]
struct MailboxState {
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
    fn lock(&self) -> MutexGuard<'_, MailboxState> {
        self.inner.lock().expect("a thread of the viewer panicked")
    }

    fn ring(&self, mut inner: MutexGuard<'_, MailboxState>) {
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
    pub(crate) fn post(&self, client: ClientId, message: FromClient) -> PostOutcome {
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
            _ if !drives => PostOutcome::Watching,
            message => inner.mail.add_event(client, message),
        };
        if posted == PostOutcome::Accepted {
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

    fn cancel(&self, inner: &mut MailboxState, client: ClientId, id: u32) -> PostOutcome {
        if inner.under_way == Some((client, id)) {
            self.is_shot_wanted.store(false, Ordering::Release);
        }
        let count = inner.shots.len();
        inner.shots.retain(|shot| (shot.client, shot.id) != (client, id));
        if inner.shots.len() < count { PostOutcome::Cancelled } else { PostOutcome::Accepted }
    }

    /// Waits until there is something to take, or `longest` has passed.
    pub(crate) fn wait(&self, longest: Duration) {
        let waits = |_: &mut MailboxState| !self.has_event();
        let _ = self.bell.wait_timeout_while(self.lock(), longest, waits);
    }
}

impl MailboxState {
    fn give_wheel(&mut self, client: ClientId) -> PostOutcome {
        let is_idle = self.heard.is_none_or(|heard| heard.elapsed() >= WHEEL_IDLE);
        if self.driver.is_some_and(|driver| driver != client) && !is_idle {
            return PostOutcome::Driven;
        }
        (self.driver, self.heard) = (Some(client), Some(Instant::now()));
        self.mail.roles = true;
        PostOutcome::Accepted
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mail::{EDITS_MAX, Edit, QUESTIONS_MAX};

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
            assert_eq!(mailbox.post(1, camera(2 * seq)), PostOutcome::Accepted);
            assert_eq!(mailbox.post(1, material(2 * seq + 1)), PostOutcome::Accepted);
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
            (0..most).for_each(|_| assert_eq!(mailbox.post(1, make()), PostOutcome::Accepted));
            assert_eq!(mailbox.post(1, make()), PostOutcome::Full);
        }
        (0..SHOTS_MAX).for_each(|_| assert_eq!(mailbox.post(1, shot()), PostOutcome::Accepted));
        assert_eq!(mailbox.post(1, shot()), PostOutcome::Full);
        assert_eq!(mailbox.collect().edits.len(), EDITS_MAX);
        assert_eq!(mailbox.post(1, material(3)), PostOutcome::Accepted);
        // What was asked by who has gone is for nobody.
        mailbox.leave(1);
        assert!(mailbox.collect().shot.is_none() && !mailbox.has_event());
    }

    /// Who took the wheel was taken for the one who had edited before, and was not told.
    #[test]
    fn who_sent_what_waits_is_known() {
        let mailbox = Mailbox::default();
        mailbox.join(1, [64, 64]);
        assert_eq!(mailbox.collect().author, None, "a size of nobody's");
        mailbox.post(1, material(1));
        mailbox.leave(1);
        mailbox.join(2, [64, 64]);
        assert_eq!(mailbox.driver(), Some(2));
        assert_eq!(mailbox.collect().author, Some(1));
        mailbox.post(2, material(1));
        mailbox.post(2, camera(2));
        assert_eq!(mailbox.collect().author, Some(2));
        mailbox.post(2, camera(3));
        mailbox.leave(2);
        mailbox.join(3, [64, 64]);
        mailbox.post(3, material(1));
        mailbox.post(3, material(2));
        assert_eq!(mailbox.collect().author, None, "of two");
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
            assert_eq!(mailbox.post(1, message(&lights)), PostOutcome::Accepted);
            assert_eq!(mailbox.post(1, material(seq)), PostOutcome::Accepted);
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
            assert_eq!(mailbox.post(client, message(&text)), PostOutcome::Accepted);
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
        assert_eq!(say(2, 1, shot), PostOutcome::Watching);
        (1..=4).for_each(|id| assert_eq!(say(1, id, shot), PostOutcome::Accepted));
        assert_eq!(mailbox.collect().shot.unwrap().id, 1);
        assert!(mailbox.wants_shot() && mailbox.has_event());
        assert_eq!((say(2, 1, cancel), say(1, 2, cancel)), (PostOutcome::Accepted, PostOutcome::Cancelled));
        assert!(mailbox.wants_shot());
        assert_eq!(say(1, 1, cancel), PostOutcome::Accepted);
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
        assert_eq!(mailbox.post(2, camera(1)), PostOutcome::Watching);
        assert!(!mailbox.has_event());
        assert_eq!(mailbox.post(2, FromClient::Drive {}), PostOutcome::Driven);
        // Who has been idle for long enough.
        mailbox.lock().heard = Instant::now().checked_sub(WHEEL_IDLE);
        assert_eq!(mailbox.post(2, FromClient::Drive {}), PostOutcome::Accepted);
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

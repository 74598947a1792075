//! `SharedState`: what the threads of the viewer have in common.
//!
//! Locks, in the order in which they may be held together: greeting, atlas, picture, the list of clients, statistics,
//! an outbox. The mailbox is held alone.
//!
//! Invariant: a client that is in the list has had, or has waiting, a welcome of the state at that moment.

use crate::atlas::{Atlas, FrameWidth, frame_bytes};
use crate::client::Client;
use crate::connections::{CLIENTS_MAX, CONNECTIONS_MAX, Connections};
use crate::http::HEAD_BYTES_MAX;
use crate::mail::MAILBOX_BYTES;
use crate::mailbox::Mailbox;
use crate::message::{MESSAGE_BYTES_MAX, Role};
use crate::outbox::{File, Outbox, TEXT_BYTES_MAX};
use crate::picture::{BlockChanges, Picture, SettledPng};
use crate::reception::Admission;
use crate::renderer::Stamps;
use crate::state::{State, Stats, TextsText};
use std::net::TcpStream;
use std::sync::atomic::{AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use trex_store::{Budget, Lease, Result};

/// Bytes of a client beside frames and texts that go out: what is read, and parts of two stacks.
const CLIENT_BYTES: usize = MESSAGE_BYTES_MAX + (32 << 10);
/// Bytes of a connection that is no client: a head, and a part of the stack.
pub(crate) const CONNECTION_BYTES: usize = HEAD_BYTES_MAX + (16 << 10);
/// A settled picture takes at most so much, and this share of its pixels' bytes more.
const PNG_FIXED_BYTES: u64 = 64 << 10;
const PNG_MORE: u64 = 50;

/// See the module's description.
#[derive(Debug)]
pub(crate) struct SharedState {
    pub(crate) admission: Admission,
    pub(crate) mailbox: Mailbox,
    greeting: Mutex<State>,
    /// The last statistics, for those who come later.
    stats: Mutex<Option<Arc<Stats>>>,
    atlas: Mutex<Atlas>,
    picture: Mutex<Picture>,
    /// Held by the one client whose frame is wide, for as long as it has one.
    wide_frame: Mutex<()>,
    clients: Mutex<Vec<Arc<Client>>>,
    pub(crate) connections: Connections,
    /// How long a page may be silent that something was sent to.
    silence_max: Duration,
    /// Clients that have a place, whether they have said hello or not.
    pub(crate) places: AtomicUsize,
    last_id: AtomicU32,
    /// Bytes and frames that went to clients which have gone.
    pub(crate) gone_bytes: AtomicU64,
    pub(crate) gone_frames: AtomicU64,
    lease: Mutex<Lease>,
}

/// Bytes that a viewer of pictures of `full` pixels takes beside its session: what is shown, the blocks that are
/// encoded, the settled picture, what waits in the mailbox, for each client its frame and its texts, and one wide frame
/// in place of a narrow one.
pub fn view_bytes(full: [u32; 2]) -> u64 {
    let [wide, narrow] = [FrameWidth::Wide, FrameWidth::Narrow].map(|width| frame_bytes(full, width));
    let clients = CLIENTS_MAX * (narrow + TEXT_BYTES_MAX + CLIENT_BYTES) + wide - narrow;
    let connections = (CONNECTIONS_MAX - CLIENTS_MAX) * CONNECTION_BYTES;
    // What is kept for those who come later, and a text in the making.
    let texts = 2 * TEXT_BYTES_MAX + MAILBOX_BYTES;
    let pictures = Picture::bytes(full) + Stamps::bytes(full) + Atlas::bytes(full) + png_bytes(full);
    pictures + (clients + connections + texts) as u64
}

/// Most bytes of a settled picture.
pub(crate) fn png_bytes([width, height]: [u32; 2]) -> u64 {
    let pixels = 3 * u64::from(width) * u64::from(height);
    pixels + pixels / PNG_MORE + u64::from(height) + PNG_FIXED_BYTES
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().expect("a thread of the viewer panicked")
}

impl SharedState {
    /// What is shared while pictures have `full` pixels.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for [`view_bytes`].
    pub(crate) fn new(
        admission: Admission,
        silence_max: Duration,
        full: [u32; 2],
        budget: &Budget,
    ) -> Result<SharedState> {
        let lease = budget.lease("the viewer", view_bytes(full))?;
        Ok(SharedState {
            admission,
            mailbox: Mailbox::default(),
            greeting: Mutex::default(),
            stats: Mutex::default(),
            atlas: Mutex::default(),
            picture: Mutex::new(Picture::new(full)),
            wide_frame: Mutex::default(),
            clients: Mutex::default(),
            connections: Connections::default(),
            silence_max,
            places: AtomicUsize::new(0),
            last_id: AtomicU32::new(0),
            gone_bytes: AtomicU64::new(0),
            gone_frames: AtomicU64::new(0),
            lease: Mutex::new(lease),
        })
    }

    /// What is on show.
    pub(crate) fn picture(&self) -> MutexGuard<'_, Picture> {
        lock(&self.picture)
    }

    /// The room for a wide frame, as long as it is held: for the page that drives, and for one at a time. One that
    /// drove before may still be sending its last.
    pub(crate) fn wide_frame(&self, client: u32) -> Option<MutexGuard<'_, ()>> {
        let drives = self.mailbox.driver() == Some(client);
        drives.then(|| self.wide_frame.try_lock().ok()).flatten()
    }

    /// The blocks that are encoded.
    pub(crate) fn atlas(&self) -> MutexGuard<'_, Atlas> {
        lock(&self.atlas)
    }

    /// Leases what pictures of `full` pixels take more than those on show; [`SharedState::resize`] takes it, or
    /// gives it back.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`]; all is as it was then.
    pub(crate) fn make_room(&self, full: [u32; 2]) -> Result<()> {
        let mut lease = lock(&self.lease);
        let more = view_bytes(full).saturating_sub(lease.bytes());
        lease.grow("the viewer", more)
    }

    /// Shows pictures of `full` pixels from now on, for which there is room; nothing is sent of them before the first.
    pub(crate) fn resize(&self, full: [u32; 2]) {
        let (mut atlas, mut picture) = (self.atlas(), self.picture());
        let mut lease = lock(&self.lease);
        if picture.full == full {
            return lease.shrink_to(view_bytes(full));
        }
        assert!(lease.bytes() >= view_bytes(full), "room is made before it is taken");
        *atlas = Atlas::default();
        let (frame, seq) = (picture.frame + 1, picture.seq);
        // Gone before the next is taken.
        picture.rgb = Vec::new();
        *picture = Picture::new(full);
        (picture.frame, picture.seq) = (frame, seq);
        lease.shrink_to(view_bytes(full));
        lock(&self.clients).iter().for_each(|client| client.begin(picture.unseen()));
    }

    /// Takes a client in, with a page of `size` pixels; `None` once the server ends.
    pub(crate) fn admit(&self, stream: Arc<TcpStream>, size: [u32; 2]) -> Option<Arc<Client>> {
        let id = self.last_id.fetch_add(1, Ordering::Relaxed) + 1;
        self.mailbox.join(id, size);
        let client = self.admit_as(id, stream);
        if client.is_none() {
            self.mailbox.leave(id);
        }
        client
    }

    fn admit_as(&self, id: u32, stream: Arc<TcpStream>) -> Option<Arc<Client>> {
        let role = self.mailbox.role(id);
        let greeting = lock(&self.greeting);
        let picture = self.picture();
        let mut clients = lock(&self.clients);
        // Whoever ends the server asks for the list after that is known: nobody comes in between.
        if self.connections.are_refused() {
            return None;
        }
        let outbox = Outbox::new(picture.unseen(), picture.settled.clone(), self.silence_max);
        let client = Arc::new(Client::new(id, stream, outbox));
        clients.push(client.clone());
        client.send_text(greeting.welcome(role, clients.len()));
        if let Some(stats) = &*lock(&self.stats) {
            client.send_stats(stats);
        }
        Some(client)
    }

    /// Lets a client go.
    pub(crate) fn dismiss(&self, client: &Client) {
        lock(&self.clients).retain(|other| other.id != client.id);
        let (bytes, frames) = client.outbox().sent();
        self.gone_bytes.fetch_add(bytes, Ordering::Relaxed);
        self.gone_frames.fetch_add(frames, Ordering::Relaxed);
        self.mailbox.leave(client.id);
    }

    /// The clients that there are now.
    pub(crate) fn clients(&self) -> Vec<Arc<Client>> {
        lock(&self.clients).clone()
    }

    /// Sends statistics to every client, and keeps them for those who come later.
    pub(crate) fn send_stats(&self, stats: Stats) {
        let stats = Arc::new(stats);
        lock(&self.clients).iter().for_each(|client| client.send_stats(&stats));
        *lock(&self.stats) = Some(stats);
    }

    /// Sends a text to one client, if it is still there.
    pub(crate) fn send_text(&self, id: u32, text: impl FnOnce() -> String) {
        if let Some(client) = lock(&self.clients).iter().find(|client| client.id == id) {
            client.send_text(text());
        }
    }

    /// Sends a file to one client, if it is still there.
    pub(crate) fn send_file(&self, id: u32, file: File) {
        if let Some(client) = lock(&self.clients).iter().find(|client| client.id == id) {
            client.send_file(file);
        }
    }

    /// Sends what has changed of the state to all clients but one, and keeps it for those who come later.
    pub(crate) fn send_state(&self, update: State, but: Option<u32>) {
        let mut greeting = lock(&self.greeting);
        let driver = self.mailbox.driver();
        let clients = lock(&self.clients);
        for client in clients.iter().filter(|client| Some(client.id) != but) {
            let role = if driver == Some(client.id) { Role::Drive } else { Role::Watch };
            client.send_text(update.update(role, clients.len()));
        }
        greeting.merge(update);
    }

    /// What is said to who comes.
    pub(crate) fn set_greeting(&self, state: State) {
        *lock(&self.greeting) = state;
    }

    /// Keeps the view as texts for those who come later.
    pub(crate) fn keep_texts(&self, texts: TextsText) {
        lock(&self.greeting).merge(State { texts: Some(texts), ..State::default() });
    }

    /// Clients that ever were.
    pub(crate) fn admitted(&self) -> u64 {
        self.last_id.load(Ordering::Relaxed).into()
    }

    /// Marks what has changed with every client. The picture is held meanwhile, so that none comes in between.
    pub(crate) fn mark(&self, picture: &Picture, changed: &BlockChanges) {
        lock(&self.clients).iter().for_each(|client| client.mark(changed, picture.layout));
    }

    /// Sends the settled picture to every client.
    pub(crate) fn settle(&self, settled: SettledPng) {
        let mut picture = self.picture();
        lock(&self.clients).iter().for_each(|client| client.settle(&settled));
        picture.settled = Some(settled);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::guard::{Embedders, Token};
    use std::net::TcpListener;

    /// What is shared, and where it listens.
    fn shared() -> (SharedState, TcpListener) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let token = Token::random().unwrap();
        let admission = Admission::new(&listener, token, &[], Embedders::default()).unwrap();
        let silence_max = Duration::from_secs(60);
        (SharedState::new(admission, silence_max, [64, 64], &Budget::unlimited()).unwrap(), listener)
    }

    fn admit(shared: &SharedState, listener: &TcpListener) -> Option<Arc<Client>> {
        let stream = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        shared.admit(Arc::new(stream), [64, 64])
    }

    /// One wide frame is leased: the page that drives has it, once.
    #[test]
    fn one_client_at_a_time_has_a_wide_frame() {
        let (shared, listener) = shared();
        let [driver, other] = [0; 2].map(|_| admit(&shared, &listener).unwrap());
        let wide = shared.wide_frame(driver.id);
        assert!(wide.is_some() && shared.wide_frame(driver.id).is_none());
        drop(wide);
        assert!(shared.wide_frame(other.id).is_none() && shared.wide_frame(driver.id).is_some());
    }

    /// A hello that came after the interrupt was let in: its threads waited for ever, and the viewer with them.
    #[test]
    fn nobody_is_let_in_once_the_server_ends() {
        let (shared, listener) = shared();
        let first = admit(&shared, &listener).unwrap();
        shared.dismiss(&first);
        shared.connections.refuse();
        assert!(admit(&shared, &listener).is_none() && shared.clients().is_empty());
        assert_eq!(shared.mailbox.driver(), None);
    }
}

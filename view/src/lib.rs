//! trex-view: a live session in the browser.
//!
//! Life of a frame: a drag on the page becomes a camera message, which `socket` reads and puts into the `mailbox`, in
//! place of the camera that was there. The session loop stops the frame under way, applies the event, and has the
//! [`LiveSession`](trex_render::LiveSession) make a picture of it. `picture` takes over the tiles whose stamp has
//! changed, in 8 bits (`tone`), and marks the `blocks` that differ, for each `client`. A client's writer, once its
//! page has drawn the frame before, copies what is marked into the `atlas`, encodes it as one JPEG, and sends it. When
//! nothing changes any more the picture goes once as PNG, and all threads sleep.
//!
//! ```text
//! tone guard page http     radiance to bytes; who may ask; what is there; how it is asked
//! blocks picture atlas     which blocks have changed; what is shown; how it is sent
//! bounded connections      bytes that an encoder may write; connections that are open
//! wire message settings    numbers of the protocol; what pages say
//! materials                parts of the list of materials
//! state texts reports      what they are told; the view as command and scene; figures of the command
//! mail                     what waits for the session
//! mailbox client shared    from reader to session; from session to writer; both
//! outbox                   what goes to a page next, and when it was heard
//! window                   how much a frame may hold
//! reception waiting        who is let in; what pages are told before there is a session
//! socket server serve      two threads a page; connections; the beginning and the end
//! session_loop edits       frames; events
//! on_show                  the view as texts, and as it is at the end
//! screenshot motion        pictures at leisure; whether the hand moves
//! ```
//!
//! This crate knows sockets, picture codecs and a live session. It names no file and no page of one: what it needs of
//! those comes in as [`Surroundings`]. Its threads end with [`serve`].

mod atlas;
mod blocks;
mod bounded;
mod client;
mod connections;
mod edits;
mod figures;
mod guard;
mod http;
mod mail;
mod mailbox;
mod materials;
mod memory_room;
mod message;
mod motion;
mod on_show;
mod outbox;
mod page;
mod parts;
mod picture;
mod reception;
mod renderer;
mod reports;
mod screenshot;
mod serve;
mod server;
mod session_loop;
mod settings;
mod shared;
mod socket;
mod state;
mod surroundings;
mod texts;
mod tone;
mod waiting;
mod window;
mod wire;

pub use edits::SIDE_MAX;
pub use guard::{Embedders, Token};
pub use reports::{DeviceFigures, MemoryFigures, ModelFigures, PoolFigures};
pub use serve::serve;
pub use shared::view_bytes;
pub use surroundings::{
    Exchange, KeptLightBytes, Recipe, Room, SILENCE_MAX, ServeOptions, ServeReport, Surroundings,
};
pub use waiting::{WaitingRoom, WaitingText};

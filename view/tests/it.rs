//! The server with pages that a test plays, against a real session on a small model.

#[path = "it/client.rs"]
mod client;
#[path = "it/damage.rs"]
mod damage;
#[path = "it/ending.rs"]
mod ending;
#[path = "it/guard.rs"]
mod guard;
#[path = "it/hostile.rs"]
mod hostile;
#[path = "it/materials.rs"]
mod materials;
#[path = "it/stage.rs"]
mod stage;
#[path = "it/stream.rs"]
mod stream;
#[path = "it/wishes.rs"]
mod wishes;

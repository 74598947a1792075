//! `Stream`: turns a recipe (an ordered list of small tasks) into a `TriangleSource` made by several threads.
//!
//! ```text
//!   tasks (in order, under a lock) -> workers fill chunks -> shelf, ordered by ticket -> next_batch
//! ```
//!
//! Invariants: 1. chunks leave the shelf in the order of their tasks, so the stream does not depend on the
//! thread count; 2. no worker runs further ahead than `window` tasks, so memory is bounded by
//! [`lease_bytes`], leased before the first thread starts; 3. a chunk never holds more than
//! [`MAX_CHUNK_TRIANGLES`]; 4. dropping the stream joins every thread.

use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use trex_store::{
    Aabb, Budget, Interrupt, Lease, Material, Result, ScanHint, SourceStats, TriangleBatch, TriangleSource,
};

/// Most triangles that one task makes: twice what a batch aims at, so that a chunk can be handed over whole.
pub(crate) const MAX_CHUNK_TRIANGLES: usize = 2 * TriangleBatch::TARGET_TRIANGLES;

/// How much memory a recipe may hold besides its chunks.
pub(crate) const RECIPE_BYTES: u64 = 8 << 20;

/// Most workers; more would only wait, and the window grows with them.
const MAX_WORKERS: usize = 16;

/// An ordered list of tasks and the way to make triangles of one.
pub(crate) trait Recipe: Send + Sync + 'static {
    /// What a worker takes along; small.
    type Task: Send;
    /// What a worker keeps between tasks.
    type Scratch: Default;

    /// All tasks, in the order of the stream. Runs under a lock: most of the work belongs into `make`.
    fn tasks(self: Arc<Self>) -> Box<dyn Iterator<Item = Self::Task> + Send>;

    /// Appends the triangles of `task`, at most [`MAX_CHUNK_TRIANGLES`], to the empty `out`.
    fn make(&self, task: Self::Task, scratch: &mut Self::Scratch, out: &mut TriangleBatch);
}

/// What a stream says about itself.
pub(crate) struct Label {
    pub(crate) name: String,
    pub(crate) hint: ScanHint,
    pub(crate) materials: Vec<Material>,
}

/// A recipe while it streams.
pub(crate) struct Stream<R: Recipe> {
    recipe: Arc<R>,
    label: Label,
    workers: usize,
    interrupt: Interrupt,
    crew: Option<Crew<R>>,
    /// The chunk being handed out, and how much of it is gone.
    open_chunk: TriangleBatch,
    open_from: usize,
    delivered: u64,
    _lease: Lease,
}

/// The threads of one pass and what they share.
struct Crew<R: Recipe> {
    shared: Arc<Shared<R>>,
    threads: Vec<JoinHandle<()>>,
}

struct Shared<R: Recipe> {
    recipe: Arc<R>,
    tasks: Mutex<Tickets<R::Task>>,
    shelf: Mutex<Shelf>,
    changed: Condvar,
    window: u64,
}

struct Tickets<T> {
    tasks: Box<dyn Iterator<Item = T> + Send>,
    next: u64,
}

#[derive(Default)]
struct Shelf {
    ready: BTreeMap<u64, TriangleBatch>,
    spare: Vec<TriangleBatch>,
    next_out: u64,
    /// Count of tasks, once the list has ended.
    end: Option<u64>,
    stop: bool,
    /// A worker has panicked.
    broken: bool,
}

/// Recipes think of the ground as x and y. Models are delivered as scans and most pictures have it, with y upwards.
pub(crate) fn y_up([x, y, z]: [f64; 3]) -> [f64; 3] {
    // Not -y, which would tell 0 from -0.
    [x, z, 0.0 - y]
}

fn y_up_bounds(bounds: &Aabb) -> Aabb {
    let (lo, hi) = (y_up(bounds.lo), y_up(bounds.hi));
    Aabb { lo: [lo[0], lo[1], hi[2]], hi: [hi[0], hi[1], lo[2]] }
}

/// Bytes that a stream of `threads` workers leases.
pub(crate) fn lease_bytes(threads: usize) -> u64 {
    let chunks = window(workers(threads)) + workers(threads) as u64 + 2;
    chunks * TriangleBatch::BYTES + RECIPE_BYTES
}

fn workers(threads: usize) -> usize {
    threads.clamp(1, MAX_WORKERS)
}

fn window(workers: usize) -> u64 {
    2 * workers as u64 + 2
}

impl<R: Recipe> Stream<R> {
    /// # Errors
    /// `Code::MemoryLimit` when the budget has no room for the chunks in flight.
    pub(crate) fn new(
        recipe: R,
        label: Label,
        threads: usize,
        budget: &Budget,
        interrupt: Interrupt,
    ) -> Result<Stream<R>> {
        let lease = budget.lease("the generator's chunks", lease_bytes(threads))?;
        let mut label = label;
        label.hint.bounds = y_up_bounds(&label.hint.bounds);
        Ok(Stream {
            recipe: Arc::new(recipe),
            label,
            workers: workers(threads),
            interrupt,
            crew: None,
            open_chunk: TriangleBatch::default(),
            open_from: 0,
            delivered: 0,
            _lease: lease,
        })
    }

    /// Replaces the open chunk with the next one. `false`: there is none.
    fn next_chunk(&mut self) -> bool {
        let crew = self.crew.get_or_insert_with(|| Crew::start(&self.recipe, self.workers));
        let spent = std::mem::take(&mut self.open_chunk);
        self.open_from = 0;
        match crew.take(spent) {
            Some(chunk) => {
                self.open_chunk = chunk;
                true
            }
            None => false,
        }
    }

    /// Moves triangles of the open chunk into `batch`, all of them where they fit.
    fn pour(&mut self, batch: &mut TriangleBatch) {
        if batch.is_empty() && self.open_from == 0 {
            std::mem::swap(batch, &mut self.open_chunk);
            return;
        }
        let room = MAX_CHUNK_TRIANGLES - batch.len();
        let to = self.open_chunk.len().min(self.open_from + room);
        batch.corners.extend_from_slice(&self.open_chunk.corners[self.open_from..to]);
        batch.material.extend_from_slice(&self.open_chunk.material[self.open_from..to]);
        self.open_from = to;
    }
}

impl<R: Recipe> TriangleSource for Stream<R> {
    fn name(&self) -> String {
        self.label.name.clone()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        self.interrupt.check()?;
        batch.clear();
        while batch.len() < TriangleBatch::TARGET_TRIANGLES {
            if self.open_from == self.open_chunk.len() && !self.next_chunk() {
                break;
            }
            self.pour(batch);
        }
        self.delivered += batch.len() as u64;
        Ok(!batch.is_empty())
    }

    fn rewind(&mut self) -> Result<()> {
        self.crew = None;
        self.open_chunk.clear();
        self.open_from = 0;
        self.delivered = 0;
        Ok(())
    }

    fn hint(&self) -> Option<ScanHint> {
        Some(self.label.hint)
    }

    fn materials(&self) -> &[Material] {
        &self.label.materials
    }

    fn stats(&self) -> SourceStats {
        SourceStats { triangle_count: self.delivered, ..SourceStats::default() }
    }
}

impl<R: Recipe> Crew<R> {
    fn start(recipe: &Arc<R>, workers: usize) -> Crew<R> {
        let shared = Arc::new(Shared {
            recipe: recipe.clone(),
            tasks: Mutex::new(Tickets { tasks: recipe.clone().tasks(), next: 0 }),
            shelf: Mutex::new(Shelf::default()),
            changed: Condvar::new(),
            window: window(workers),
        });
        let threads = (0..workers)
            .map(|index| {
                let shared = shared.clone();
                std::thread::Builder::new()
                    .name(format!("generate-{index}"))
                    .spawn(move || shared.work())
                    .expect("the system starts a thread")
            })
            .collect();
        Crew { shared, threads }
    }

    /// The next chunk in order; `spent` is a buffer to use again.
    fn take(&self, mut spent: TriangleBatch) -> Option<TriangleBatch> {
        spent.clear();
        let mut shelf = self.shared.shelf();
        shelf.spare.push(spent);
        loop {
            assert!(!shelf.broken, "a generator thread panicked");
            let ticket = shelf.next_out;
            if let Some(chunk) = shelf.ready.remove(&ticket) {
                shelf.next_out += 1;
                drop(shelf);
                self.shared.changed.notify_all();
                return Some(chunk);
            }
            if shelf.end == Some(ticket) {
                return None;
            }
            shelf = self.shared.wait(shelf);
        }
    }
}

impl<R: Recipe> Drop for Crew<R> {
    fn drop(&mut self) {
        self.shared.shelf().stop = true;
        self.shared.changed.notify_all();
        for thread in self.threads.drain(..) {
            // A panic of the worker has been reported by its own message and by `take`.
            let _ = thread.join();
        }
    }
}

impl<R: Recipe> Shared<R> {
    /// A worker's life.
    fn work(&self) {
        let _alarm = Alarm(self);
        let mut scratch = R::Scratch::default();
        while let Some((ticket, task)) = self.next_task() {
            let Some(mut chunk) = self.admit(ticket) else { return };
            self.recipe.make(task, &mut scratch, &mut chunk);
            chunk.corners.as_flattened_mut().iter_mut().for_each(|corner| *corner = y_up(*corner));
            assert!(chunk.len() <= MAX_CHUNK_TRIANGLES, "a task made {} triangles", chunk.len());
            self.shelf().ready.insert(ticket, chunk);
            self.changed.notify_all();
        }
    }

    /// The next task and its place in the stream; at the end of the list, tells the reader.
    fn next_task(&self) -> Option<(u64, R::Task)> {
        let mut tickets = self.tasks.lock().unwrap_or_else(PoisonError::into_inner);
        let ticket = tickets.next;
        match tickets.tasks.next() {
            Some(task) => {
                tickets.next += 1;
                Some((ticket, task))
            }
            None => {
                drop(tickets);
                self.shelf().end = Some(ticket);
                self.changed.notify_all();
                None
            }
        }
    }

    /// Waits until `ticket` is within the window, then hands out an empty buffer. `None`: stop.
    fn admit(&self, ticket: u64) -> Option<TriangleBatch> {
        let mut shelf = self.shelf();
        loop {
            if shelf.stop {
                return None;
            }
            if ticket < shelf.next_out + self.window {
                return Some(shelf.spare.pop().unwrap_or_default());
            }
            shelf = self.wait(shelf);
        }
    }

    fn shelf(&self) -> MutexGuard<'_, Shelf> {
        self.shelf.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, shelf: MutexGuard<'a, Shelf>) -> MutexGuard<'a, Shelf> {
        self.changed.wait(shelf).unwrap_or_else(PoisonError::into_inner)
    }
}

/// Tells the reader when a worker ends by a panic, so that it does not wait for ever.
struct Alarm<'a, R: Recipe>(&'a Shared<R>);

impl<R: Recipe> Drop for Alarm<'_, R> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.shelf().broken = true;
            self.0.changed.notify_all();
        }
    }
}

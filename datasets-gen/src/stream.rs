//! `Stream`: turns a recipe (an ordered list of small tasks) into a `TriangleSource` made by a pool of threads.
//!
//! ```text
//!   next_batch keeps `window` jobs going:  next task (in order, under a lock) -> chunk -> shelf, ordered by ticket
//! ```
//!
//! Invariants: 1. chunks leave the shelf in the order of their tasks, so the stream does not depend on the
//! thread count; 2. a job is started for each chunk that is taken, so no more than `window` are at work or on the
//! shelf, and memory is bounded by [`lease_bytes`], leased before the first job starts; 3. a chunk never holds more
//! than [`MAX_CHUNK_TRIANGLES`]; 4. dropping the stream waits for its jobs and joins every thread; no job waits.

use crate::GenOptions;
use crate::pool::{Pool, thread_count};
use std::collections::BTreeMap;
use std::iter::Fuse;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use trex_store::{
    Aabb, AttributeSet, Interrupt, Lease, MaterialList, Result, ScanHint, SourceStats, TriangleBatch,
    TriangleSource,
};

/// Most triangles that one task makes: twice what a batch aims at, so that a chunk can be handed over whole.
pub(crate) const MAX_CHUNK_TRIANGLES: usize = 2 * TriangleBatch::TARGET_TRIANGLES;

/// How much memory a recipe may hold besides its chunks.
pub(crate) const RECIPE_BYTES: u64 = 8 << 20;

/// An ordered list of tasks and the way to make triangles of one.
pub(crate) trait Recipe: Send + Sync + 'static {
    /// What a job takes along; small.
    type Task: Send;
    /// What is kept between tasks, one for each that is at work.
    type Scratch: Default + Send;

    /// All tasks, in the order of the stream. Runs under a lock: most of the work belongs into `make`.
    fn tasks(self: Arc<Self>) -> Box<dyn Iterator<Item = Self::Task> + Send>;

    /// Appends the triangles of `task`, at most [`MAX_CHUNK_TRIANGLES`], to the empty `out`.
    fn make(&self, task: Self::Task, scratch: &mut Self::Scratch, out: &mut TriangleBatch);
}

/// What a stream says about itself.
pub(crate) struct Label {
    pub(crate) name: String,
    pub(crate) hint: ScanHint,
    pub(crate) materials: MaterialList,
}

/// A recipe while it streams.
pub(crate) struct Stream<R: Recipe> {
    recipe: Arc<R>,
    label: Label,
    interrupt: Interrupt,
    /// Before the pool: its jobs end first.
    pass: Option<Pass<R>>,
    pool: Pool,
    /// The chunk being handed out, and how much of it is gone.
    open_chunk: TriangleBatch,
    open_from: usize,
    delivered: u64,
    _lease: Lease,
}

/// One pass over the tasks.
struct Pass<R: Recipe>(Arc<PassState<R>>);

/// What the jobs of a pass and its reader share.
struct PassState<R: Recipe> {
    recipe: Arc<R>,
    tasks: Mutex<Tickets<R::Task>>,
    shelf: Mutex<Shelf<R::Scratch>>,
    changed: Condvar,
}

struct Tickets<T> {
    tasks: Fuse<Box<dyn Iterator<Item = T> + Send>>,
    next: u64,
}

struct Shelf<S> {
    ready: BTreeMap<u64, TriangleBatch>,
    spare_chunks: Vec<TriangleBatch>,
    spare_scratch: Vec<S>,
    next_out: u64,
    /// Jobs that have been started and have not ended.
    job_count: usize,
    /// Count of tasks, once the list has ended.
    end: Option<u64>,
    stop: bool,
    /// A job has panicked.
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

/// Bytes that a stream of `threads` threads leases.
pub(crate) fn lease_bytes(threads: usize) -> u64 {
    let threads = thread_count(threads);
    let chunks = (window(threads) + threads + 2) as u64;
    chunks * TriangleBatch::bytes(AttributeSet::default()) + RECIPE_BYTES
}

/// Chunks that are made ahead of the reader.
fn window(threads: usize) -> usize {
    2 * threads + 2
}

impl<R: Recipe> Stream<R> {
    /// # Errors
    /// `Code::MemoryLimit` when the budget has no room for the chunks in flight.
    pub(crate) fn new(recipe: R, label: Label, pool: Pool, options: &GenOptions) -> Result<Stream<R>> {
        let lease = options.budget.lease("the generator's chunks", lease_bytes(options.threads))?;
        let mut label = label;
        label.hint.bounds = y_up_bounds(&label.hint.bounds);
        Ok(Stream {
            recipe: Arc::new(recipe),
            label,
            interrupt: options.interrupt.clone(),
            pass: None,
            pool,
            open_chunk: TriangleBatch::default(),
            open_from: 0,
            delivered: 0,
            _lease: lease,
        })
    }

    /// Replaces the open chunk with the next one. `false`: there is none.
    fn next_chunk(&mut self) -> bool {
        let pass = self.pass.get_or_insert_with(|| Pass::start(&self.recipe, &self.pool));
        let spent = std::mem::take(&mut self.open_chunk);
        self.open_from = 0;
        match pass.take(spent, &self.pool) {
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
        self.pass = None;
        self.open_chunk.clear();
        self.open_from = 0;
        self.delivered = 0;
        Ok(())
    }

    fn hint(&self) -> Option<ScanHint> {
        Some(self.label.hint)
    }

    fn materials(&self) -> &MaterialList {
        &self.label.materials
    }

    fn stats(&self) -> SourceStats {
        SourceStats { triangle_count: self.delivered, ..SourceStats::default() }
    }
}

impl<R: Recipe> Pass<R> {
    fn start(recipe: &Arc<R>, pool: &Pool) -> Pass<R> {
        let shelf = Shelf {
            ready: BTreeMap::new(),
            spare_chunks: Vec::new(),
            spare_scratch: Vec::new(),
            next_out: 0,
            job_count: 0,
            end: None,
            stop: false,
            broken: false,
        };
        let pass = Pass(Arc::new(PassState {
            recipe: recipe.clone(),
            tasks: Mutex::new(Tickets { tasks: recipe.clone().tasks().fuse(), next: 0 }),
            shelf: Mutex::new(shelf),
            changed: Condvar::new(),
        }));
        (0..window(pool.current_num_threads())).for_each(|_| pass.start_job(pool));
        pass
    }

    fn start_job(&self, pool: &Pool) {
        self.0.shelf().job_count += 1;
        let shared = self.0.clone();
        pool.spawn(move || shared.work());
    }

    /// The next chunk in order; `spent` is a buffer to use again.
    fn take(&self, mut spent: TriangleBatch, pool: &Pool) -> Option<TriangleBatch> {
        spent.clear();
        let mut shelf = self.0.shelf();
        shelf.spare_chunks.push(spent);
        loop {
            assert!(!shelf.broken, "a job of the generator panicked");
            let ticket = shelf.next_out;
            if let Some(chunk) = shelf.ready.remove(&ticket) {
                shelf.next_out += 1;
                let is_more = shelf.end.is_none();
                drop(shelf);
                if is_more {
                    self.start_job(pool);
                }
                return Some(chunk);
            }
            if shelf.end == Some(ticket) {
                return None;
            }
            shelf = self.0.wait(shelf);
        }
    }
}

impl<R: Recipe> Drop for Pass<R> {
    fn drop(&mut self) {
        let mut shelf = self.0.shelf();
        shelf.stop = true;
        while shelf.job_count > 0 {
            shelf = self.0.wait(shelf);
        }
    }
}

impl<R: Recipe> PassState<R> {
    /// One job: the next task becomes a chunk on the shelf.
    fn work(&self) {
        let _end = JobEnd(self);
        let (mut chunk, mut scratch) = {
            let mut shelf = self.shelf();
            if shelf.stop {
                return;
            }
            (shelf.spare_chunks.pop().unwrap_or_default(), shelf.spare_scratch.pop().unwrap_or_default())
        };
        let Some((ticket, task)) = self.next_task() else { return };
        self.recipe.make(task, &mut scratch, &mut chunk);
        chunk.corners.as_flattened_mut().iter_mut().for_each(|corner| *corner = y_up(*corner));
        assert!(chunk.len() <= MAX_CHUNK_TRIANGLES, "a task made {} triangles", chunk.len());
        let mut shelf = self.shelf();
        shelf.ready.insert(ticket, chunk);
        shelf.spare_scratch.push(scratch);
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
                None
            }
        }
    }

    fn shelf(&self) -> MutexGuard<'_, Shelf<R::Scratch>> {
        self.shelf.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, shelf: MutexGuard<'a, Shelf<R::Scratch>>) -> MutexGuard<'a, Shelf<R::Scratch>> {
        self.changed.wait(shelf).unwrap_or_else(PoisonError::into_inner)
    }
}

/// Tells the reader that a job has ended, by a panic too, so that it does not wait for ever.
struct JobEnd<'a, R: Recipe>(&'a PassState<R>);

impl<R: Recipe> Drop for JobEnd<'_, R> {
    fn drop(&mut self) {
        let mut shelf = self.0.shelf();
        shelf.job_count -= 1;
        shelf.broken |= std::thread::panicking();
        drop(shelf);
        self.0.changed.notify_all();
    }
}

//! `ReadThreads`: a few threads, each of which reads what is asked for and waits for it.
//!
//! Invariants: 1. a read is either queued, in the hands of one thread, or done (where the system refuses threads, those
//! are the caller's hands); 2. dropping the backend lets reads that
//! are in a thread's hands end, joins the threads, and only then frees buffers.

use super::{Backend, IoDescription, RawCompletion, RawRead, Wait, check_read};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::JoinHandle;

/// Reads what is asked for, and says how many bytes came.
type ReadCall = Box<dyn Fn(&mut RawRead) -> std::io::Result<usize> + Send + Sync>;

/// Says what went wrong since the file was opened, if anything did.
type NoticeCall = Box<dyn Fn() -> Option<String> + Send>;

/// What reads, and the threads that it is called from.
pub(super) struct ThreadsSetup {
    pub(super) description: IoDescription,
    pub(super) align_bytes: usize,
    /// Most reads in flight.
    pub(super) depth: usize,
    /// No more than `depth` are started.
    pub(super) threads: usize,
    /// What a call needs.
    pub(super) stack_bytes: usize,
    pub(super) read: ReadCall,
    /// One line for people, once something went wrong that ends no read.
    pub(super) notice: NoticeCall,
}

/// Reads with a pool of threads.
pub struct ReadThreads {
    shared: Arc<ThreadsState>,
    threads: Vec<JoinHandle<()>>,
    depth: usize,
    in_flight: usize,
    align_bytes: usize,
    notice: NoticeCall,
    pub(super) description: IoDescription,
}

struct ThreadsState {
    read: ReadCall,
    queues: Mutex<Queues>,
    work: Condvar,
    done: Condvar,
}

struct Queues {
    waiting: VecDeque<RawRead>,
    done: Vec<RawCompletion>,
    stop: bool,
}

impl ReadThreads {
    /// Starts the threads, named after the backend.
    pub(super) fn new(setup: ThreadsSetup) -> ReadThreads {
        let ThreadsSetup { description, align_bytes, depth, threads, stack_bytes, read, notice } = setup;
        let queues =
            Queues { waiting: VecDeque::with_capacity(depth), done: Vec::with_capacity(depth), stop: false };
        let shared = Arc::new(ThreadsState {
            read,
            queues: Mutex::new(queues),
            work: Condvar::new(),
            done: Condvar::new(),
        });
        let start = |index| {
            let shared = Arc::clone(&shared);
            let thread = std::thread::Builder::new().name(format!("trex-{}-{index}", description.backend));
            thread.stack_size(stack_bytes).spawn(move || shared.serve()).ok()
        };
        // As many as the system gives; with none, the caller reads.
        let threads = (0..threads.clamp(1, depth)).map_while(start).collect();
        ReadThreads { shared, threads, depth, in_flight: 0, align_bytes, notice, description }
    }
}

impl ThreadsState {
    fn lock(&self) -> MutexGuard<'_, Queues> {
        self.queues.lock().expect("a reading thread panicked")
    }

    fn serve(&self) {
        let mut queues = self.lock();
        loop {
            if queues.stop {
                return;
            }
            let Some(mut read) = queues.waiting.pop_front() else {
                queues = self.work.wait(queues).expect("a reading thread panicked");
                continue;
            };
            drop(queues);
            let result = (self.read)(&mut read);
            queues = self.lock();
            queues.done.push(RawCompletion { read, result });
            self.done.notify_one();
        }
    }
}

impl Backend for ReadThreads {
    fn describe(&self) -> &IoDescription {
        &self.description
    }

    fn align_bytes(&self) -> usize {
        self.align_bytes
    }

    fn depth(&self) -> usize {
        self.depth
    }

    fn in_flight(&self) -> usize {
        self.in_flight
    }

    fn submit(&mut self, read: RawRead) {
        check_read(&read, self.in_flight, self.depth, self.align_bytes);
        self.in_flight += 1;
        self.shared.lock().waiting.push_back(read);
        self.shared.work.notify_one();
    }

    fn complete(&mut self, wait: Wait, done: &mut Vec<RawCompletion>) {
        let mut queues = self.shared.lock();
        if self.threads.is_empty() {
            while let Some(mut read) = queues.waiting.pop_front() {
                let result = (self.shared.read)(&mut read);
                queues.done.push(RawCompletion { read, result });
            }
        }
        while wait == Wait::One && queues.done.is_empty() && self.in_flight > 0 {
            queues = self.shared.done.wait(queues).expect("a reading thread panicked");
        }
        self.in_flight -= queues.done.len();
        done.append(&mut queues.done);
        drop(queues);
        if self.description.notice.is_none() {
            self.description.notice = (self.notice)();
        }
    }
}

impl Drop for ReadThreads {
    fn drop(&mut self) {
        self.shared.lock().stop = true;
        self.shared.work.notify_all();
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

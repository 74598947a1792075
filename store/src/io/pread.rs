//! `Pread`: a few threads that call `pread`. Works on every kernel and every file system.
//!
//! Invariants: 1. a read is either queued, in the hands of one thread, or done (where the system refuses threads, those
//! are the caller's hands); 2. dropping the backend lets reads that
//! are in a thread's hands end, joins the threads, and only then frees buffers; 3. buffered reads are dropped from the
//! page cache once copied.

use super::page_cache::drop_cached;
use super::{Backend, IoDescription, RawCompletion, RawRead, Source, Wait, check_read};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::JoinHandle;

/// Stack of a reading thread: it calls `pread` and nothing else.
const STACK_BYTES: usize = 64 << 10;

/// Reads with a pool of threads.
pub struct Pread {
    shared: Arc<PreadState>,
    threads: Vec<JoinHandle<()>>,
    depth: usize,
    in_flight: usize,
    align_bytes: usize,
    pub(super) description: IoDescription,
}

struct PreadState {
    source: Source,
    queues: Mutex<Queues>,
    work: Condvar,
    done: Condvar,
}

struct Queues {
    waiting: VecDeque<RawRead>,
    done: Vec<RawCompletion>,
    stop: bool,
}

impl Pread {
    /// Starts up to `threads` threads (at most `depth`) that read from `source`.
    pub(super) fn new(source: Source, depth: usize, threads: usize, reason: String) -> Pread {
        let description = IoDescription::new("pread", source.direct, reason);
        let align_bytes = source.align_bytes();
        let queues =
            Queues { waiting: VecDeque::with_capacity(depth), done: Vec::with_capacity(depth), stop: false };
        let shared = Arc::new(PreadState {
            source,
            queues: Mutex::new(queues),
            work: Condvar::new(),
            done: Condvar::new(),
        });
        let start = |index| {
            let shared = Arc::clone(&shared);
            let thread = std::thread::Builder::new().name(format!("trex-pread-{index}"));
            thread.stack_size(STACK_BYTES).spawn(move || shared.serve()).ok()
        };
        // As many as the system gives; with none, the caller reads.
        let threads = (0..threads.clamp(1, depth)).map_while(start).collect();
        Pread { shared, threads, depth, in_flight: 0, align_bytes, description }
    }
}

impl PreadState {
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
            let result = self.read(&mut read);
            queues = self.lock();
            queues.done.push(RawCompletion { read, result });
            self.done.notify_one();
        }
    }

    fn read(&self, read: &mut RawRead) -> std::io::Result<usize> {
        let (offset, bytes) = (read.offset, read.bytes);
        let got = rustix::io::retry_on_intr(|| rustix::io::pread(&self.source.file, read.target(), offset))?;
        if !self.source.direct {
            drop_cached(&self.source.file, offset, bytes as u64);
        }
        Ok(got)
    }
}

impl Backend for Pread {
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
                let result = self.shared.read(&mut read);
                queues.done.push(RawCompletion { read, result });
            }
        }
        while wait == Wait::One && queues.done.is_empty() && self.in_flight > 0 {
            queues = self.shared.done.wait(queues).expect("a reading thread panicked");
        }
        self.in_flight -= queues.done.len();
        done.append(&mut queues.done);
    }
}

impl Drop for Pread {
    fn drop(&mut self) {
        self.shared.lock().stop = true;
        self.shared.work.notify_all();
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

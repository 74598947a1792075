//! `Pool`: the threads of one generator, in a rayon pool of its own.
//!
//! Invariants: 1. the count of threads is stated, never the machine's; 2. dropping the pool joins every thread, so
//! nothing of a generator outlives it; 3. a job that panics ends alone: who waits for it has to be told by the job.

use crate::Spec;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::ops::Deref;
use std::thread::{Builder, JoinHandle};
use trex_store::{Error, Result};

/// Most threads; more would only wait, and the window of a stream grows with them.
const MAX_THREADS: usize = 16;

/// A rayon pool whose threads have names and are joined.
pub(crate) struct Pool {
    /// Empty only while it is dropped.
    pool: Option<ThreadPool>,
    threads: Vec<JoinHandle<()>>,
}

/// How many threads a generator that is asked for `threads` has.
pub(crate) fn thread_count(threads: usize) -> usize {
    threads.clamp(1, MAX_THREADS)
}

impl Pool {
    /// Starts the threads of the generator of `spec`.
    ///
    /// # Errors
    /// `Code::Io` when the system does not start them.
    pub(crate) fn new(spec: &Spec, threads: usize) -> Result<Pool> {
        let count = thread_count(threads);
        let mut threads = Vec::with_capacity(count);
        let built = ThreadPoolBuilder::new()
            .num_threads(count)
            .spawn_handler(|thread| {
                let name = format!("generate-{}", thread.index());
                threads.push(Builder::new().name(name).spawn(|| thread.run())?);
                Ok(())
            })
            // Its message has been printed; by default rayon would end the process.
            .panic_handler(|_| {})
            .build();
        match built {
            Ok(pool) => Ok(Pool { pool: Some(pool), threads }),
            Err(error) => {
                // Those that have started end by themselves.
                threads.drain(..).for_each(join);
                Err(Error::threads_refused(count, &error).at_place(spec.to_string()))
            }
        }
    }
}

impl Deref for Pool {
    type Target = ThreadPool;

    fn deref(&self) -> &ThreadPool {
        self.pool.as_ref().expect("there until it is dropped")
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        // Tells the threads to end when their jobs have.
        self.pool = None;
        self.threads.drain(..).for_each(join);
    }
}

fn join(thread: JoinHandle<()>) {
    // What a job panics with never gets here.
    let _ = thread.join();
}

//! `WorkerThreads`: the threads of data-parallel work: handed in, or started here and joined by whoever lets go of them
//! last.
//!
//! Invariant: where threads were started here, none of them is left when the last clone has been dropped, unless that
//! was done by one of them.

use rayon::{ThreadPool, ThreadPoolBuilder};
use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};
use trex_store::{Error, Result};

/// Threads of a rayon pool; clones share them.
#[derive(Clone, Debug)]
pub struct WorkerThreads(Arc<Threads>);

#[derive(Debug)]
struct Threads {
    /// `None` while they end.
    pool: Option<Arc<ThreadPool>>,
    /// Of those that were started here.
    handles: Mutex<Vec<JoinHandle<()>>>,
}

impl WorkerThreads {
    /// Starts `count` threads, called `worker-0` and so on.
    ///
    /// # Errors
    /// [`trex_store::Code::Io`] when the system refuses a thread.
    pub fn start(count: usize) -> Result<WorkerThreads> {
        let handles = Mutex::new(Vec::with_capacity(count));
        let pool = ThreadPoolBuilder::new()
            .num_threads(count)
            .thread_name(|index| format!("worker-{index}"))
            .spawn_handler(|thread| {
                let name = thread.name().unwrap_or("worker").to_owned();
                let handle = Builder::new().name(name).spawn(|| thread.run())?;
                handles.lock().unwrap_or_else(PoisonError::into_inner).push(handle);
                Ok(())
            })
            .build()
            .map_err(|error| Error::threads_refused(count, &error))?;
        Ok(WorkerThreads(Arc::new(Threads { pool: Some(Arc::new(pool)), handles })))
    }
}

impl From<Arc<ThreadPool>> for WorkerThreads {
    /// The threads of a pool that is somebody else's to end.
    fn from(pool: Arc<ThreadPool>) -> WorkerThreads {
        WorkerThreads(Arc::new(Threads { pool: Some(pool), handles: Mutex::default() }))
    }
}

impl Deref for WorkerThreads {
    type Target = ThreadPool;

    fn deref(&self) -> &ThreadPool {
        self.0.pool.as_ref().expect("it is there until the last clone goes")
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        self.pool = None;
        let handles = std::mem::take(self.handles.get_mut().unwrap_or_else(PoisonError::into_inner));
        for handle in handles {
            if handle.thread().id() != std::thread::current().id() {
                // A panic in there was raised again where its work was asked for.
                let _ = handle.join();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    struct Alive(&'static AtomicUsize);

    impl Drop for Alive {
        fn drop(&mut self) {
            std::thread::sleep(std::time::Duration::from_millis(20));
            self.0.fetch_sub(1, Ordering::SeqCst);
        }
    }

    /// What a thread keeps for itself is gone with the last clone: it has ended, and was not only told to.
    #[test]
    fn threads_have_ended_when_the_last_clone_goes() {
        static LEFT: AtomicUsize = AtomicUsize::new(0);
        thread_local!(static ALIVE: Alive = {
            LEFT.fetch_add(1, Ordering::SeqCst);
            Alive(&LEFT)
        });
        let threads = WorkerThreads::start(3).unwrap();
        threads.broadcast(|_| ALIVE.with(|_| ()));
        let other = threads.clone();
        drop(threads);
        assert_eq!((other.current_num_threads(), LEFT.load(Ordering::SeqCst)), (3, 3));
        drop(other);
        assert_eq!(LEFT.load(Ordering::SeqCst), 0);
    }
}

//! `RunWriter`: packs runs and writes them to scratch, on a thread of its own.
//!
//! Invariants: 1. runs come back in the order in which they were given; 2. no more than [`MOST`] are under way;
//! 3. an error comes back in the place of its run.

use super::{Encoder, Run, Scratch, TriangleList};
use crate::error::{Error, Result};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

/// Most runs under way.
const MOST: usize = 16;

/// A run that is written, and whose it is.
pub(crate) struct WrittenRun {
    pub(crate) owner: usize,
    pub(crate) run: Run,
    /// Triangles that its buffer had room for.
    pub(crate) room: u64,
}

/// The thread's handle. Dropped, it waits for what is under way.
pub(crate) struct RunWriter {
    scratch: Arc<Scratch>,
    /// `None` once no more can come.
    jobs: Option<SyncSender<(usize, TriangleList)>>,
    done: Receiver<Result<WrittenRun>>,
    under_way: usize,
    thread: Option<JoinHandle<()>>,
}

impl RunWriter {
    /// Starts the thread.
    ///
    /// # Errors
    /// [`Code::Io`] where the system gives none.
    pub(crate) fn start(scratch: Scratch) -> Result<RunWriter> {
        let (jobs, given) = sync_channel::<(usize, TriangleList)>(MOST);
        let (answers, done) = sync_channel(MOST);
        let scratch = Arc::new(scratch);
        let file = Arc::clone(&scratch);
        let write_all = move || {
            let mut encoder = Encoder::default();
            while let Ok((owner, triangles)) = given.recv() {
                let run = file.append(encoder.encode(&triangles), triangles.len());
                // The memory goes back before the run counts as written.
                let room = triangles.room();
                drop(triangles);
                if answers.send(run.map(|run| WrittenRun { owner, run, room })).is_err() {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("trex-cells".into()).spawn(write_all);
        let thread = thread.map_err(|error| Error::thread_refused("the writer of scratch", &error))?;
        Ok(RunWriter { scratch, jobs: Some(jobs), done, under_way: 0, thread: Some(thread) })
    }

    /// The file.
    pub(crate) fn scratch(&self) -> &Scratch {
        &self.scratch
    }

    /// Gives a run to the thread; waits for the first of those under way where they are [`MOST`], and gives it.
    pub(crate) fn write(&mut self, owner: usize, triangles: TriangleList) -> Result<Option<WrittenRun>> {
        let written = if self.under_way == MOST { self.next()? } else { None };
        let jobs = self.jobs.as_ref().expect("runs come before the end");
        jobs.send((owner, triangles)).expect("the thread takes runs until the channel is closed");
        self.under_way += 1;
        Ok(written)
    }

    /// The first of those under way, once it is written; `None` where there are none.
    pub(crate) fn next(&mut self) -> Result<Option<WrittenRun>> {
        if self.under_way == 0 {
            return Ok(None);
        }
        self.under_way -= 1;
        self.done.recv().expect("the thread answers all that it was given").map(Some)
    }

    /// Ends the thread, and gives the file back. What is under way must have been taken before.
    pub(crate) fn finish(self) -> Scratch {
        assert_eq!(self.under_way, 0, "runs that nobody took");
        let scratch = Arc::clone(&self.scratch);
        drop(self);
        Arc::into_inner(scratch).expect("the thread has ended")
    }
}

impl Drop for RunWriter {
    fn drop(&mut self) {
        self.jobs = None;
        // It ends: there is room for all answers. A panic of it shows where its answer is awaited.
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

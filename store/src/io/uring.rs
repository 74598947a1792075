//! `Uring`: reads through io_uring, submitted and reaped in batches by one system call.
//!
//! Unsafe code stands here because the kernel writes to the buffers of queued reads.
//!
//! Invariants
//! 1. `flights[i]` owns the buffer of the queued read with user data `i` until its completion has been reaped.
//! 2. Drop reaps every read. Should the ring itself fail, the buffers are leaked: lost memory is better than memory
//!    that the kernel writes to after it was given to somebody else.
//! 3. No more than `depth` reads are queued, so neither queue can overflow.
//! 4. Buffered reads leave nothing in the page cache: RWF_DONTCACHE where the kernel has it (6.14), fadvise elsewhere.
#![allow(unsafe_code)]

use super::open::drop_cached;
use super::{Backend, IoDescription, RawDone, RawRead, Source, Wait, check_read};
use io_uring::{IoUring, opcode, types};
use std::io::{Error, ErrorKind, Result};
use std::os::fd::AsRawFd;

/// Tells the kernel to drop what a buffered read brought to the cache.
const RWF_DONTCACHE: i32 = 0x80;

/// Tries of one system call that reports EINTR, EAGAIN or EBUSY before the ring counts as broken.
const ENTER_TRIES_MAX: u32 = 1000;

/// Reads through a ring of its own.
pub struct Uring {
    ring: IoUring,
    source: Source,
    flights: Vec<Option<RawRead>>,
    free: Vec<u32>,
    /// A ring that failed: what was asked of it since fails with this error number.
    broken: Option<i32>,
    uncached: bool,
    description: IoDescription,
}

impl Uring {
    /// Sets a ring up and reads once through it. Gives the source back when the kernel refuses.
    pub(super) fn new(
        source: Source,
        depth: usize,
        reason: String,
    ) -> std::result::Result<Uring, (Source, Error)> {
        // Completions are reaped by the thread that waits for them: no interrupt of other work is needed.
        let ring = IoUring::builder()
            .setup_coop_taskrun()
            .build(depth as u32)
            .or_else(|_| IoUring::new(depth as u32));
        let ring = match ring {
            Ok(ring) => ring,
            Err(error) => return Err((source, error)),
        };
        let description = IoDescription { backend: "uring".into(), direct: source.direct, reason };
        let mut uring = Uring {
            ring,
            uncached: !source.direct,
            source,
            flights: (0..depth).map(|_| None).collect(),
            free: (0..depth as u32).collect(),
            broken: None,
            description,
        };
        match uring.probe() {
            Ok(()) => Ok(uring),
            Err(error) => {
                let file = uring.source.file.try_clone();
                match file {
                    Ok(file) => Err((Source { file, direct: uring.source.direct }, error)),
                    // No descriptor left: the ring that failed will say so with each read.
                    Err(_) => Ok(uring),
                }
            }
        }
    }

    /// One read, to see that opcode and flags work (kernels before 5.6 have rings without plain reads).
    fn probe(&mut self) -> Result<()> {
        for _ in 0..2 {
            let staging = super::Staging::new(super::ALIGN_BYTES).map_err(Error::other)?;
            let mut done = Vec::with_capacity(1);
            self.submit(RawRead { tag: 0, offset: 0, at: 0, bytes: super::ALIGN_BYTES, staging });
            self.complete(Wait::One, &mut done);
            match done.pop().map(|done| done.result) {
                Some(Ok(_)) => return Ok(()),
                Some(Err(_)) if self.uncached => self.uncached = false,
                Some(Err(error)) => return Err(error),
                None => return Err(Error::other("a read did not come back")),
            }
        }
        Ok(())
    }

    /// Submits what is queued and waits for `want` completions. An error means that the ring is broken.
    fn enter(&self, want: usize) -> Result<()> {
        for _ in 0..ENTER_TRIES_MAX {
            match self.ring.submit_and_wait(want) {
                Ok(_) => return Ok(()),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::ResourceBusy) => {
                    std::thread::yield_now();
                }
                Err(error) => return Err(error),
            }
        }
        Err(ErrorKind::TimedOut.into())
    }

    fn reap(&mut self, done: &mut Vec<RawDone>) {
        for entry in self.ring.completion() {
            let index = entry.user_data() as usize;
            let read = self.flights[index].take().expect("a completion without a read");
            self.free.push(index as u32);
            let result = match entry.result() {
                got @ 0.. => Ok(got as usize),
                errno => Err(Error::from_raw_os_error(-errno)),
            };
            if !self.source.direct && !self.uncached {
                drop_cached(&self.source.file, read.offset, read.bytes);
            }
            done.push(RawDone { read, result });
        }
    }
}

impl Backend for Uring {
    fn describe(&self) -> &IoDescription {
        &self.description
    }

    fn align_bytes(&self) -> usize {
        self.source.align_bytes()
    }

    fn depth(&self) -> usize {
        self.flights.len()
    }

    fn in_flight(&self) -> usize {
        self.flights.len() - self.free.len()
    }

    fn submit(&mut self, mut read: RawRead) {
        check_read(&read, self.in_flight(), self.depth(), self.align_bytes());
        let index = self.free.pop().expect("checked above");
        let target = read.target();
        let entry = opcode::Read::new(
            types::Fd(self.source.file.as_raw_fd()),
            target.as_mut_ptr(),
            target.len() as u32,
        )
        .offset(read.offset)
        .rw_flags(if self.uncached { RWF_DONTCACHE } else { 0 })
        .build()
        .user_data(u64::from(index));
        self.flights[index as usize] = Some(read);
        // SAFETY: buffer and file live in `self` until the completion has been reaped (invariants 1 and 2); moving
        // the `RawRead` moves a handle, not the mapped memory.
        let pushed = unsafe { self.ring.submission().push(&entry) };
        assert!(pushed.is_ok(), "the ring has fewer entries than the depth");
    }

    fn complete(&mut self, wait: Wait, done: &mut Vec<RawDone>) {
        let in_flight = self.in_flight();
        if in_flight == 0 {
            return;
        }
        if let Some(errno) = self.broken {
            // The kernel may hold the buffers still: they stay in `flights`, and the reads fail with new ones.
            return self.fail_all(errno, done);
        }
        let before = done.len();
        self.reap(done);
        let want = usize::from(wait == Wait::One && done.len() == before);
        if let Err(error) = self.enter(want) {
            self.broken = Some(error.raw_os_error().unwrap_or(rustix::io::Errno::IO.raw_os_error()));
        }
        self.reap(done);
    }
}

impl Uring {
    /// Ends all reads of a broken ring. The old buffers are leaked (invariant 2).
    fn fail_all(&mut self, errno: i32, done: &mut Vec<RawDone>) {
        for (index, flight) in self.flights.iter_mut().enumerate() {
            if let Some(mut read) = flight.take() {
                let fresh = super::Staging::new(read.staging.len()).expect("no memory after a broken ring");
                std::mem::forget(std::mem::replace(&mut read.staging, fresh));
                done.push(RawDone { read, result: Err(Error::from_raw_os_error(errno)) });
                self.free.push(index as u32);
            }
        }
    }
}

impl Drop for Uring {
    fn drop(&mut self) {
        let mut done = Vec::new();
        while self.in_flight() > 0 && self.broken.is_none() {
            self.complete(Wait::One, &mut done);
        }
        for read in self.flights.drain(..).flatten() {
            std::mem::forget(read);
        }
    }
}

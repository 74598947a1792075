//! `Uring`: reads through io_uring, submitted and reaped in batches by one system call.
//!
//! Unsafe code stands here because the kernel writes to the buffers of queued reads.
//!
//! ```text
//! submit -> queue (the kernel takes from it in `enter` alone) -> in the kernel's hands -> completion -> reaped
//!              '--- a ring that failed is never entered again: taken back ---'   '--- still awaited ---'
//! ```
//!
//! Invariants
//! 1. `flights[i]` owns the buffer of the read with user data `i` until its completion has been reaped, or until it is
//!    known that the kernel never took it.
//! 2. No more than `depth` reads are queued, so neither queue can overflow.
//! 3. Buffered reads leave nothing in the page cache: RWF_DONTCACHE where the kernel has it (6.14), fadvise elsewhere.
//! 4. A ring whose `enter` has failed is left for good. Reads that the kernel has not taken (it moves the head of the
//!    queue for each that it takes) come back as they were. The others are still the kernel's: completions are written
//!    to shared memory without our asking, so they are waited for by looking there. One that has not come within
//!    [`PATIENCE`] is read again elsewhere into another buffer, and its own is set aside until it does come: the one
//!    memory that nobody leases, at most a buffer for each read in flight.
//! 5. Closing a ring only *begins* to cancel what is in flight, so no drop may rely on it. Drop waits for completions;
//!    what a ring that failed still owes after [`PATIENCE`] is leaked: lost memory is better than memory that the
//!    kernel writes to after it was given to somebody else.
#![allow(unsafe_code)]

use super::page_cache::drop_cached;
use super::{Backend, IoDescription, RawCompletion, RawRead, Source, StagingBuffer, Wait, check_read};
use io_uring::{IoUring, opcode, types};
use std::collections::VecDeque;
use std::io::{Error, ErrorKind, Result};
use std::os::fd::AsRawFd;
use std::time::{Duration, Instant};

/// Tells the kernel to drop what a buffered read brought to the cache.
const RWF_DONTCACHE: i32 = 0x80;

/// Tries of one system call that reports EINTR, EAGAIN or EBUSY before the ring counts as broken.
const ENTER_TRIES_MAX: u32 = 1000;

/// How long a read of a ring that failed may take. A disk that works answers in a tenth of that under any load.
const PATIENCE: Duration = Duration::from_secs(1);

/// Sleep between two looks for completions of a ring that failed; each is a kernel entry, which lets them be posted.
pub(super) const GLANCE: Duration = Duration::from_micros(200);

/// Reads through a ring of its own.
pub struct Uring {
    ring: IoUring,
    source: Source,
    flights: Vec<Option<Flight>>,
    free: Vec<u32>,
    /// Reads in the queue, in its order; the kernel takes from the front.
    queued: VecDeque<u32>,
    /// Flights whose reads were taken back.
    set_aside: usize,
    /// Why the ring was left, and when.
    failed: Option<(Error, Instant)>,
    uncached: bool,
    description: IoDescription,
    /// Lets `enter` fail after so many calls.
    #[cfg(test)]
    pub(super) enters_left: Option<u32>,
}

/// A read that the ring has.
struct Flight {
    read: RawRead,
    /// It was taken back: only its buffer is waited for.
    is_set_aside: bool,
}

impl Uring {
    /// Sets a ring up and reads once through it. An error when the kernel refuses.
    pub(super) fn new(source: Source, depth: usize, reason: String) -> Result<Uring> {
        // Completions are reaped by the thread that waits for them: no interrupt of other work is needed.
        let ring = IoUring::builder()
            .setup_coop_taskrun()
            .build(depth as u32)
            .or_else(|_| IoUring::new(depth as u32))?;
        let description = IoDescription::new("uring", source.direct, reason);
        let mut uring = Uring {
            ring,
            uncached: !source.direct,
            source,
            flights: (0..depth).map(|_| None).collect(),
            free: (0..depth as u32).collect(),
            queued: VecDeque::with_capacity(depth),
            set_aside: 0,
            failed: None,
            description,
            #[cfg(test)]
            enters_left: None,
        };
        uring.probe()?;
        Ok(uring)
    }

    /// One read, to see that opcode and flags work (kernels before 5.6 have rings without plain reads).
    fn probe(&mut self) -> Result<()> {
        for _ in 0..2 {
            let staging = StagingBuffer::new(super::ALIGN_BYTES).map_err(Error::other)?;
            let mut done = Vec::with_capacity(1);
            self.submit(RawRead {
                tag: 0,
                offset: 0,
                at: 0,
                bytes: super::ALIGN_BYTES,
                failures: 0,
                staging,
            });
            self.complete(Wait::One, &mut done);
            match done.pop().map(|done| done.result) {
                Some(Ok(_)) => return Ok(()),
                Some(Err(_)) if self.uncached => self.uncached = false,
                Some(Err(error)) => return Err(error),
                None => {
                    let failed = self.failed.as_ref().map(|(error, _)| error.to_string());
                    return Err(Error::other(failed.unwrap_or("a read did not come back".into())));
                }
            }
        }
        Ok(())
    }

    /// Submits what is queued and waits for `want` completions. An error means that the ring is broken.
    fn enter(&mut self, want: usize) -> Result<()> {
        #[cfg(test)]
        if let Some(left) = &mut self.enters_left {
            *left = left.checked_sub(1).ok_or(rustix::io::Errno::NOMEM)?;
        }
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

    fn reap(&mut self, done: &mut Vec<RawCompletion>) {
        for entry in self.ring.completion() {
            let index = entry.user_data() as usize;
            let Flight { read, is_set_aside } =
                self.flights[index].take().expect("a completion without a read");
            self.free.push(index as u32);
            if is_set_aside {
                self.set_aside -= 1;
                continue;
            }
            let result = match entry.result() {
                got @ 0.. => Ok(got as usize),
                errno => Err(Error::from_raw_os_error(-errno)),
            };
            if !self.source.direct && !self.uncached {
                drop_cached(&self.source.file, read.offset, read.bytes as u64);
            }
            done.push(RawCompletion { read, result });
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
        self.flights.len() - self.free.len() - self.set_aside
    }

    fn submit(&mut self, mut read: RawRead) {
        check_read(&read, self.in_flight(), self.depth(), self.align_bytes());
        assert!(self.failed.is_none(), "a read for a ring that failed");
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
        self.flights[index as usize] = Some(Flight { read, is_set_aside: false });
        self.queued.push_back(index);
        // SAFETY: buffer and file live in `self` until the completion has been reaped or the kernel is known not to
        // have taken the read (invariants 1, 4 and 5); moving the `RawRead` moves a handle, not the mapped memory.
        let pushed = unsafe { self.ring.submission().push(&entry) };
        assert!(pushed.is_ok(), "the ring has fewer entries than the depth");
    }

    fn complete(&mut self, wait: Wait, done: &mut Vec<RawCompletion>) {
        let before = done.len();
        self.reap(done);
        if self.in_flight() == 0 || self.failed.is_some() {
            return;
        }
        let want = usize::from(wait == Wait::One && done.len() == before);
        if let Err(error) = self.enter(want) {
            self.failed = Some((error, Instant::now()));
        }
        let left = self.ring.submission().len();
        self.queued.drain(..self.queued.len() - left);
        self.reap(done);
    }
}

/// A ring that failed.
impl Uring {
    /// Why the ring was left. From then on nothing may be submitted, and [`Backend::complete`] never waits.
    pub(super) fn failure(&self) -> Option<&Error> {
        self.failed.as_ref().map(|(error, _)| error)
    }

    /// Buffers that the kernel may still write to, of reads that were taken back.
    #[cfg(test)]
    pub(super) fn set_aside(&self) -> usize {
        self.set_aside
    }

    /// Takes reads back that must be made elsewhere: those that the kernel never took; and, once [`PATIENCE`] is over,
    /// those whose completions have not come, with new buffers, as far as there is memory for these.
    pub(super) fn take_back(&mut self, reads: &mut Vec<RawRead>) {
        let Some((_, since)) = &self.failed else { return };
        let is_late = since.elapsed() >= PATIENCE;
        self.take_unsent(reads);
        if self.in_flight() == 0 || !is_late {
            return;
        }
        for flight in self.flights.iter_mut().flatten().filter(|flight| !flight.is_set_aside) {
            let RawRead { tag, offset, at, bytes, failures, ref staging } = flight.read;
            // Without memory the old buffer goes on waiting.
            let Ok(staging) = StagingBuffer::new(staging.len()) else { return };
            reads.push(RawRead { tag, offset, at, bytes, failures, staging });
            flight.is_set_aside = true;
            self.set_aside += 1;
        }
    }

    /// Takes back what the kernel never took.
    fn take_unsent(&mut self, reads: &mut Vec<RawRead>) {
        for index in self.queued.drain(..) {
            reads.extend(self.flights[index as usize].take().map(|flight| flight.read));
            self.free.push(index);
        }
    }
}

impl Drop for Uring {
    fn drop(&mut self) {
        let mut done = Vec::new();
        while self.in_flight() > 0 && self.failed.is_none() {
            self.complete(Wait::One, &mut done);
        }
        self.take_unsent(&mut Vec::new());
        while let Some((_, since)) = &self.failed
            && self.free.len() < self.flights.len()
            && since.elapsed() < PATIENCE
        {
            std::thread::sleep(GLANCE);
            self.reap(&mut done);
        }
        for flight in self.flights.drain(..).flatten() {
            std::mem::forget(flight);
        }
    }
}

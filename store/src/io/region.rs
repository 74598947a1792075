//! `Region`: anonymous memory straight from the kernel, whose address never changes.
//!
//! Unsafe code stands here because memory is mapped, released and unmapped by system calls.
//!
//! Invariants
//! 1. `start .. start + bytes` is mapped readable and writable from `reserve` until drop.
//! 2. A page of it costs memory only once touched, and no more after [`Region::release`]; it reads as zero then.
//! 3. No huge pages: touching one byte must not commit 2 MiB that nobody has counted.
#![allow(unsafe_code)]

use crate::error::{Code, Error, Result};
use crate::next_step::NextStep;
use rustix::mm::{Advice, MapFlags, ProtFlags};
use std::ptr::NonNull;

/// Mapped anonymous memory.
pub(crate) struct Region {
    start: NonNull<u8>,
    bytes: usize,
}

// SAFETY: the region is plain memory that is owned by this value; who may touch which part of it when is up to
// the borrow of `bytes`/`bytes_mut`, or to the caller of `at`.
unsafe impl Send for Region {}
// SAFETY: as above; `&Region` gives shared reads, and raw pointers whose use is unsafe.
unsafe impl Sync for Region {}

impl Region {
    /// Reserves `bytes` of address space. Nothing is committed yet.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] when the system has no such range.
    pub(crate) fn reserve(bytes: usize) -> Result<Region> {
        assert!(bytes > 0 && bytes.is_multiple_of(super::ALIGN_BYTES));
        let flags = MapFlags::PRIVATE | MapFlags::NORESERVE;
        // SAFETY: a new private anonymous mapping at an address of the kernel's choice touches nothing that exists.
        let mapped = unsafe {
            rustix::mm::mmap_anonymous(std::ptr::null_mut(), bytes, ProtFlags::READ | ProtFlags::WRITE, flags)
        };
        let start = mapped.map_err(|errno| {
            Error::new(Code::MemoryLimit, "the system refused a range of addresses")
                .at_place("mmap")
                .numbers(format!("{bytes} bytes: {errno}"))
                .next(NextStep::LowerLimitOrRaiseAddresses)
        })?;
        let start = NonNull::new(start.cast::<u8>()).expect("mmap gave address 0");
        // SAFETY: exactly the range mapped above. A kernel without huge pages refuses, which is as good.
        let _ = unsafe { rustix::mm::madvise(start.as_ptr().cast(), bytes, Advice::LinuxNoHugepage) };
        Ok(Region { start, bytes })
    }

    /// Gives the memory of a part back to the kernel; the addresses stay.
    ///
    /// # Safety
    /// Nobody holds a reference into the part, or relies on what it says.
    pub(crate) unsafe fn release(&self, at: usize, bytes: usize) {
        assert!(at.checked_add(bytes).is_some_and(|end| end <= self.bytes), "released outside of the region");
        // SAFETY: inside of the mapping by the assert; no reference is alive by the contract.
        let released =
            unsafe { rustix::mm::madvise(self.at(at).as_ptr().cast(), bytes, Advice::LinuxDontNeed) };
        debug_assert!(released.is_ok(), "madvise: {released:?}");
    }

    /// Address of byte `at`.
    pub(crate) fn at(&self, at: usize) -> NonNull<u8> {
        assert!(at < self.bytes, "byte {at} of a region of {}", self.bytes);
        // SAFETY: inside of the mapping by the assert.
        unsafe { self.start.add(at) }
    }

    /// All of it.
    pub(crate) fn bytes(&self) -> &[u8] {
        // SAFETY: mapped and initialised (zero or written); `bytes_mut` needs `&mut`. Users of `at` never use this.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.bytes) }
    }

    /// All of it, to write.
    pub(crate) fn bytes_mut(&mut self) -> &mut [u8] {
        // SAFETY: as `bytes`, and `&mut self` makes it the only reference.
        unsafe { std::slice::from_raw_parts_mut(self.start.as_ptr(), self.bytes) }
    }
}

impl Drop for Region {
    fn drop(&mut self) {
        // SAFETY: mapped by `reserve` with this length and unmapped only here.
        let unmapped = unsafe { rustix::mm::munmap(self.start.as_ptr().cast(), self.bytes) };
        debug_assert!(unmapped.is_ok(), "munmap: {unmapped:?}");
    }
}

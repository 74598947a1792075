//! `BucketFile`: records in scratch, by bucket: written as they come, read a bucket at a time.
//!
//! ```text
//! record -> buffer of its bucket -> full, or the end: a block     block = seal | records
//! ```
//!
//! Invariants: 1. blocks have places of one size, and a block's number is its name; 2. buffers and the lists of blocks
//! are leased.

use crate::budget::{Budget, Lease};
use crate::error::Result;
use crate::scratch::{SEAL_BYTES, ScratchFile, seal};
use bytemuck::Pod;
use std::marker::PhantomData;
use std::path::Path;

/// Buckets of a file.
pub(super) const BUCKETS: usize = 1024;
/// Bytes of the place of a block.
const BLOCK_BYTES: usize = 8 << 10;
/// What is leased of a block beside its bytes: its number, in a list that may be half full.
const BLOCK_NUMBER_BYTES: u64 = 8;
/// What the memory is called in messages.
const LEASED: &str = "the buckets of corners";

/// See the module.
pub(super) struct BucketFile<R> {
    scratch: ScratchFile,
    buckets: Vec<Bucket>,
    block_count: u32,
    bytes: Vec<u8>,
    lease: Lease,
    record: PhantomData<R>,
}

#[derive(Default)]
struct Bucket {
    /// Records that no block has yet, behind room for a seal.
    pending: Vec<u8>,
    blocks: Vec<u32>,
    record_count: usize,
}

impl<R: Pod> BucketFile<R> {
    /// Records of a full block.
    const BLOCK_RECORDS: usize = (BLOCK_BYTES - SEAL_BYTES) / size_of::<R>();
    /// Bytes that a file leases at first.
    pub(super) const BYTES: u64 = ((BUCKETS + 1) * BLOCK_BYTES) as u64;

    pub(super) fn create(folder: &Path, budget: &Budget) -> Result<BucketFile<R>> {
        let lease = budget.lease(LEASED, Self::BYTES)?;
        let buckets = std::iter::repeat_with(Bucket::default).take(BUCKETS).collect();
        let scratch = ScratchFile::create(folder)?;
        Ok(BucketFile { scratch, buckets, block_count: 0, bytes: Vec::new(), lease, record: PhantomData })
    }

    /// Adds a record to a bucket.
    pub(super) fn push(&mut self, bucket: usize, record: R) -> Result<()> {
        let of = &mut self.buckets[bucket];
        if of.pending.is_empty() {
            of.pending.reserve_exact(BLOCK_BYTES);
            of.pending.resize(SEAL_BYTES, 0);
        }
        of.pending.extend_from_slice(bytemuck::bytes_of(&record));
        of.record_count += 1;
        if of.record_count.is_multiple_of(Self::BLOCK_RECORDS) { self.write_block(bucket) } else { Ok(()) }
    }

    fn write_block(&mut self, bucket: usize) -> Result<()> {
        let BucketFile { scratch, buckets, block_count, lease, .. } = self;
        let of = &mut buckets[bucket];
        lease.grow(LEASED, BLOCK_NUMBER_BYTES)?;
        seal(&mut of.pending, u64::from(*block_count));
        scratch.write(&of.pending, u64::from(*block_count) * BLOCK_BYTES as u64)?;
        of.blocks.push(*block_count);
        of.pending.clear();
        *block_count += 1;
        Ok(())
    }

    /// Writes what is pending. From now on it is read alone.
    pub(super) fn finish(&mut self) -> Result<()> {
        for bucket in 0..BUCKETS {
            if !self.buckets[bucket].pending.is_empty() {
                self.write_block(bucket)?;
            }
            self.buckets[bucket].pending = Vec::new();
        }
        self.lease.shrink_to(BLOCK_BYTES as u64 + u64::from(self.block_count) * BLOCK_NUMBER_BYTES);
        Ok(())
    }

    /// Records of a bucket.
    pub(super) fn len(&self, bucket: usize) -> usize {
        self.buckets[bucket].record_count
    }

    /// Calls `tell` with each record of a bucket, in the order in which they came.
    pub(super) fn read(&mut self, bucket: usize, mut tell: impl FnMut(R)) -> Result<()> {
        let of = &self.buckets[bucket];
        let mut left = of.record_count;
        for &block in &of.blocks {
            let count = left.min(Self::BLOCK_RECORDS);
            let length = SEAL_BYTES + count * size_of::<R>();
            let offset = u64::from(block) * BLOCK_BYTES as u64;
            let content = self.scratch.read(offset, length, u64::from(block), &mut self.bytes)?;
            content.chunks_exact(size_of::<R>()).for_each(|bytes| tell(bytemuck::pod_read_unaligned(bytes)));
            left -= count;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_come_back_by_bucket_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let budget = Budget::new(64 << 20);
        let mut file = BucketFile::<[u32; 2]>::create(folder.path(), &budget).unwrap();
        let bucket_of = |n: u32| {
            (n.wrapping_mul(0x9e37_79b9) >> 22) as usize % if n.is_multiple_of(3) { 2 } else { BUCKETS }
        };
        for n in 0..200_000 {
            file.push(bucket_of(n), [n, !n]).unwrap();
        }
        file.finish().unwrap();
        assert!(budget.used_bytes() < 1 << 20);
        for _ in 0..2 {
            for bucket in 0..BUCKETS {
                let mut found = Vec::new();
                file.read(bucket, |record| found.push(record)).unwrap();
                let expected: Vec<_> =
                    (0..200_000).filter(|n| bucket_of(*n) == bucket).map(|n| [n, !n]).collect();
                assert!(found == expected && file.len(bucket) == found.len(), "{bucket}");
            }
        }
        drop(file);
        assert_eq!((budget.used_bytes(), std::fs::read_dir(folder.path()).unwrap().count()), (0, 0));
    }
}

//! The pages of a round: some of a file, in an order by chance.

use anyhow::Context;
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use rustix::fs::{Advice, fadvise};
use std::fs::File;
use std::sync::Arc;
use trex_store::PageFile;
use trex_store::io::Extent;
use trex_store::layout::{PageKind, page_hash};

/// Pages of a round, at most.
const PAGES_MOST: usize = 1 << 14;

/// The pages of a round.
pub(super) struct Pages<'a> {
    pub(super) file: &'a Arc<PageFile>,
    pub(super) order: Vec<u32>,
    pub(super) extents: Vec<Extent>,
}

impl<'a> Pages<'a> {
    /// Pages of the mesh in an order by chance, no more than a round has.
    pub(super) fn new(file: &'a Arc<PageFile>, seed: u64) -> Pages<'a> {
        let mut order: Vec<u32> = (0..)
            .zip(file.pages())
            .filter(|(_, entry)| entry.kind == PageKind::Mesh)
            .map(|(page, _)| page)
            .collect();
        let mut rng = Pcg64::seed_from_u64(seed);
        for i in (1..order.len()).rev() {
            order.swap(i, (rng.next_u64() % (i as u64 + 1)) as usize);
        }
        order.truncate(PAGES_MOST);
        let extent = |&page: &u32| {
            let entry = &file.pages()[page as usize];
            Extent { offset: entry.offset, stored_bytes: entry.stored_bytes }
        };
        Pages { file, extents: order.iter().map(extent).collect(), order }
    }

    /// Asks the system to forget the file.
    pub(super) fn forget(&self) -> anyhow::Result<()> {
        let file = File::open(self.file.path())?;
        fadvise(&file, 0, None, Advice::DontNeed).context("the cache of the file cannot be dropped")
    }

    pub(super) fn is_sound(&self, place: usize, stored: &[u8]) -> bool {
        let page = self.order[place];
        page_hash(stored, self.file.superblock().file_id, page) == self.file.pages()[page as usize].hash
    }
}

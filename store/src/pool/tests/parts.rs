//! Pages that take parts of their frames: more of them are there than frames, and the kernel counts no more memory than
//! the pool has leased.

use super::*;
use crate::pool::frame_room::BLOCK_BYTES;
use crate::pool::signal::lock;
use std::os::unix::fs::FileExt;

const BLOCKS: u32 = (FRAME_BYTES / BLOCK_BYTES) as u32;

/// Pages that fill so many blocks at the begin of their frames, and so many at the end.
#[derive(Clone, Copy)]
struct Parts(fn(u32) -> [u32; 2]);

impl Parts {
    fn pool(self, pages: u32, frames: u64) -> PagePool {
        let bytes: Vec<u8> = (0..pages).flat_map(u32::to_le_bytes).collect();
        let backend = Box::new(Memory::new(bytes.into(), 8, 1));
        let store = Arc::new(PartsStore { pages, parts: self });
        PagePool::with_backend(store, backend, Path::new("parts"), &Budget::unlimited(), &options(frames))
            .unwrap()
    }

    /// The words of a page's frame that it fills: those of its first blocks, and those of its last.
    fn filled(&self, page: u32) -> [std::ops::Range<usize>; 2] {
        let [head, tail] = (self.0)(page).map(|blocks| blocks as usize * BLOCK_BYTES / 8);
        [0..head, FRAME_BYTES / 8 - tail..FRAME_BYTES / 8]
    }
}

struct PartsStore {
    pages: u32,
    parts: Parts,
}

impl PageStore for PartsStore {
    fn page_count(&self) -> u32 {
        self.pages
    }
    fn extent(&self, page: u32) -> Extent {
        Extent { offset: 4 * u64::from(page), stored_bytes: 4 }
    }
    fn install(&self, page: u32, stored: &[u8], frame: &mut FrameRoom<'_>, _: &mut Vec<u8>) -> Result<()> {
        assert_eq!(stored, page.to_le_bytes());
        let [head, tail] = (self.parts.0)(page).map(|blocks| blocks as usize * BLOCK_BYTES);
        let frame = frame.ends(head, tail)?;
        for word in self.parts.filled(page).into_iter().flatten() {
            frame[8 * word..][..8].copy_from_slice(&pattern(page, word).to_le_bytes());
        }
        Ok(())
    }
    /// Too few for most pages.
    fn expected_bytes(&self, _page: u32) -> usize {
        3 * BLOCK_BYTES
    }
    fn frame_bytes(&self) -> usize {
        FRAME_BYTES
    }
}

#[track_caller]
fn check_parts(parts: &Parts, page: u32, frame: &[u8]) {
    for word in parts.filled(page).into_iter().flatten() {
        let found = u64::from_le_bytes(frame[8 * word..][..8].try_into().unwrap());
        assert!(found == pattern(page, word), "word {word} of page {page} is another's");
    }
}

/// Blocks of the frames that the kernel has memory for.
fn resident_blocks(pool: &PagePool) -> usize {
    let frames = pool.page_count() as usize;
    let pagemap = std::fs::File::open("/proc/self/pagemap").unwrap();
    let mut entries = vec![0; frames * BLOCKS as usize * 8];
    let begin = pool.shared.arena.begin() / BLOCK_BYTES * 8;
    pagemap.read_exact_at(&mut entries, begin as u64).unwrap();
    entries.chunks_exact(8).filter(|entry| entry[7] >> 7 == 1).count()
}

#[test]
fn more_pages_than_frames_are_there_together() {
    let light = Parts(|page| [1 + page % 2, 1]);
    // 100 blocks, and 16 of a whole frame, in 8 frames of 16 each.
    let pool = light.pool(40, 8);
    pool.fetch_blocking(&(0..40).collect::<Vec<_>>()).unwrap();
    assert!((0..40).all(|page| pool.state(page) == PageState::Resident));
    let stats = pool.stats();
    assert_eq!((stats.pages, stats.frames, stats.evictions, stats.pages_read), (40, 8, 0, 40));
    assert_eq!(resident_blocks(&pool), 100);
    assert!(pool.room() >= 40);
    // A page that grows takes its room from the others.
    let pin = pool.pin(3).unwrap();
    for (head_bytes, evicted) in [(BLOCK_BYTES, false), (15 * BLOCK_BYTES, false), (60, false)] {
        assert!(pool.shared.grow(3, head_bytes));
        assert_eq!(pool.stats().evictions > 0, evicted);
    }
    let others: Vec<Pin> = [8, 9].map(|page| pool.pin(page).unwrap()).into();
    for pin in &others {
        assert!(pool.shared.grow(pin.page(), 15 * BLOCK_BYTES));
    }
    assert!(pool.stats().evictions > 0);
    let clock = lock(&pool.shared.clock);
    assert!(clock.used() <= 128, "{}", clock.used());
    drop(clock);
    for pin in others.iter().chain([&pin]) {
        check_parts(&light, pin.page(), pin);
    }
}

/// Those that are pinned find room as long as they are no more than whole frames; one more does not.
#[test]
fn as_many_pages_as_frames_may_grow_whole() {
    let light = Parts(|_| [1, 1]);
    let pool = light.pool(10, 3);
    let pins: Vec<Pin> = (0..4).map(|page| pool.pin_blocking(page).unwrap()).collect();
    for pin in &pins[..3] {
        let mut clock = lock(&pool.shared.clock);
        let frame = pool.shared.words[pin.page() as usize].view().frame;
        assert_eq!(
            clock.grow(frame, BLOCKS - 1, &pool.shared.words, &pool.shared.arena),
            pin.page() < 2,
            "two blocks are the fourth page's"
        );
    }
    drop(pins);
    let pin = pool.pin_blocking(2).unwrap();
    assert!(pool.shared.grow(2, 15 * BLOCK_BYTES));
    check_parts(&light, 2, &pin);
}

/// Threads pin pages, have them grow, and write to what they took, while the limit changes.
#[test]
fn pages_that_grow_stay_within_the_limit() {
    let parts = Parts(|page| [1 + page * 7 % 5, 1 + page * 11 % 8]);
    const FRAMES: u64 = 20;
    let pool = parts.pool(200, FRAMES);
    std::thread::scope(|scope| {
        for thread in 0..4u128 {
            let (pool, parts) = (&pool, &parts);
            scope.spawn(move || {
                let mut random = Pcg64Mcg::new(thread);
                for _ in 0..600 {
                    let page = random.next_u32() % 200;
                    let pin = pool.pin_blocking(page).unwrap();
                    let [head, tail] = (parts.0)(page);
                    let to = head + random.next_u32() % (BLOCKS + 1 - head - tail);
                    assert!(pool.shared.grow(page, to as usize * BLOCK_BYTES));
                    check_parts(parts, page, &pin);
                }
            });
        }
        let pool = &pool;
        scope.spawn(move || {
            for step in 0..100 {
                let frames = FRAMES - step % 9;
                pool.set_limit(frames * FRAME).unwrap();
                let clock = lock(&pool.shared.clock);
                assert!(clock.used().div_ceil(BLOCKS as usize) <= clock.live(), "{}", clock.used());
                drop(clock);
                std::thread::sleep(Duration::from_millis(2));
            }
        });
    });
    let FrameCount { frames, owed } = pool.set_limit(FRAMES * FRAME).unwrap();
    assert_eq!((frames, owed), (FRAMES as usize, 0));
    let clock = lock(&pool.shared.clock);
    assert!(resident_blocks(&pool) <= clock.used() && clock.used() <= frames * BLOCKS as usize);
    assert!(clock.evicted > 100);
}

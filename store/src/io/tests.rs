//! Every backend against the same file: the same bytes, the same ends, the same errors.

use super::*;
use crate::error::{Code, Result};
use rand_pcg::rand_core::Rng;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// Not a multiple of anything: the last extents end where no block ends.
const FILE_BYTES: usize = 3_000_017;

fn content() -> Vec<u8> {
    let mut random = rand_pcg::Pcg64Mcg::new(7);
    let mut bytes = vec![0; FILE_BYTES];
    random.fill_bytes(&mut bytes);
    bytes
}

/// Beside the crate and not in the system's temporary folder, which may be a tmpfs without direct reads.
fn file_of(bytes: &[u8]) -> tempfile::NamedTempFile {
    let mut file = tempfile::NamedTempFile::new_in(env!("CARGO_MANIFEST_DIR")).unwrap();
    file.write_all(bytes).unwrap();
    file.as_file().sync_all().unwrap();
    file
}

/// Odd offsets and lengths, one byte, both ends of the file.
fn extents() -> Vec<Extent> {
    let mut random = rand_pcg::Pcg64Mcg::new(11);
    let last = FILE_BYTES as u64 - 1;
    let mut extents = vec![
        Extent { offset: 0, stored_bytes: 1 },
        Extent { offset: 0, stored_bytes: 4096 },
        Extent { offset: 4095, stored_bytes: 2 },
        Extent { offset: last, stored_bytes: 1 },
        Extent { offset: last - 65_535, stored_bytes: 65_536 },
        Extent { offset: last - 5000, stored_bytes: 4097 },
    ];
    for _ in 0..200 {
        let stored_bytes = 1 + random.next_u32() % (66 << 10);
        let offset = random.next_u64() % (FILE_BYTES as u64 - u64::from(stored_bytes));
        extents.push(Extent { offset, stored_bytes });
    }
    extents
}

/// Reads all extents at the full depth; results in their order.
fn read_all(backend: Box<dyn Backend>, path: &Path, extents: &[Extent]) -> Vec<Result<Vec<u8>>> {
    read_all_of(&mut Reader::new(backend, path), extents)
}

fn read_all_of(reader: &mut Reader, extents: &[Extent]) -> Vec<Result<Vec<u8>>> {
    let mut idle: Vec<StagingBuffer> =
        (0..reader.room()).map(|_| StagingBuffer::new(staging_bytes_for(66 << 10)).unwrap()).collect();
    let mut results: Vec<Option<Result<Vec<u8>>>> = vec![None; extents.len()];
    let (mut next, mut arrivals) = (0, Vec::new());
    while next < extents.len() || reader.in_flight() > 0 {
        while next < extents.len() && reader.room() > 0 {
            reader.submit(next as u32, extents[next], idle.pop().unwrap());
            next += 1;
        }
        reader.complete(Wait::One, &mut arrivals);
        for Arrival { tag, staging, result } in arrivals.drain(..) {
            let bytes = result.map(|range| staging[range].to_vec());
            assert!(results[tag as usize].replace(bytes).is_none(), "read {tag} came twice");
            idle.push(staging);
        }
    }
    results.into_iter().map(|result| result.expect("a read was lost")).collect()
}

#[track_caller]
fn check_same(results: &[Result<Vec<u8>>], extents: &[Extent], content: &[u8]) {
    for (result, extent) in results.iter().zip(extents) {
        let want = &content[extent.offset as usize..extent.end() as usize];
        assert!(result.as_ref().unwrap() == want, "{extent:?} differs");
    }
}

#[test]
fn all_backends_give_the_same_bytes() {
    let content = content();
    let file = file_of(&content);
    let extents = extents();
    for io in [IoChoice::Auto, IoChoice::Uring, IoChoice::Pread, IoChoice::Mmap] {
        for direct in [DirectChoice::Auto, DirectChoice::On, DirectChoice::Off] {
            if (io, direct) == (IoChoice::Mmap, DirectChoice::On) {
                continue;
            }
            let options = IoOptions { io, direct, depth: 8, pread_threads: 3, connections: 0 };
            match open(file.path(), &options) {
                Ok(backend) => {
                    let results = read_all(backend, file.path(), &extents);
                    check_same(&results, &extents, &content);
                }
                Err(error) => {
                    let by_name = io == IoChoice::Uring || direct == DirectChoice::On;
                    assert!(by_name, "the ladder has no end: {error}");
                    // This machine's kernel or file system lacks it: said aloud, and counted as not run.
                    let _ = writeln!(std::io::stderr(), "NOT RUN: {io:?} {direct:?}: {error}");
                }
            }
        }
    }
    let shared: Arc<[u8]> = content.as_slice().into();
    for align in [1, ALIGN_BYTES] {
        let memory = Memory::new(Arc::clone(&shared), 8, align);
        check_same(&read_all(Box::new(memory), file.path(), &extents), &extents, &content);
    }
}

#[test]
fn a_description_says_which_and_why() {
    let file = file_of(&[1; 5000]);
    let options = IoOptions { io: IoChoice::Pread, direct: DirectChoice::Off, ..IoOptions::default() };
    let backend = open(file.path(), &options).unwrap();
    let description = backend.describe();
    assert_eq!((description.backend.as_str(), description.direct), ("pread", false));
    assert_eq!(description.reason, "pread was asked for; buffered reads were asked for");
}

#[test]
fn what_cannot_be_met_is_refused() {
    let file = file_of(&[1; 5000]);
    let mmap_direct = IoOptions { io: IoChoice::Mmap, direct: DirectChoice::On, ..IoOptions::default() };
    let no_depth = IoOptions { depth: 0, ..IoOptions::default() };
    for options in [mmap_direct, no_depth] {
        assert_eq!(open(file.path(), &options).err().unwrap().code(), Code::Usage);
    }
    let missing = Path::new("/nonexistent/file");
    assert_eq!(open(missing, &IoOptions::default()).err().unwrap().code(), Code::InputUnreadable);
    assert_eq!("zip".parse::<IoChoice>().unwrap_err().code(), Code::Usage);
    assert_eq!("on".parse::<DirectChoice>().unwrap(), DirectChoice::On);
}

#[test]
fn a_file_that_ends_early_is_damaged() {
    let file = file_of(&[1; 5000]);
    let past = [
        Extent { offset: 4990, stored_bytes: 11 },
        Extent { offset: 5000, stored_bytes: 1 },
        Extent { offset: 1 << 40, stored_bytes: 9 },
    ];
    for io in [IoChoice::Auto, IoChoice::Pread, IoChoice::Mmap] {
        for direct in [DirectChoice::Auto, DirectChoice::Off] {
            let backend = open(file.path(), &IoOptions { io, direct, ..IoOptions::default() }).unwrap();
            for result in read_all(backend, file.path(), &past) {
                let error = result.unwrap_err();
                assert_eq!(error.code(), Code::Damaged, "{io:?} {direct:?}: {error}");
                assert!(error.place().contains(" at byte "), "{error}");
            }
        }
    }
}

/// A file that shrank under a mapping ended the process with SIGBUS.
#[test]
fn a_file_that_shrinks_while_it_is_read_is_damaged() {
    for io in [IoChoice::Auto, IoChoice::Pread, IoChoice::Mmap] {
        let content = content();
        let file = file_of(&content);
        let options = IoOptions { io, direct: DirectChoice::Off, depth: 4, pread_threads: 2, connections: 0 };
        let mut reader = Reader::new(open(file.path(), &options).unwrap(), file.path());
        let at = |offset, stored_bytes| Extent { offset, stored_bytes };
        let before = [at(0, 100), at(1_000_000, 60_000)];
        check_same(&read_all_of(&mut reader, &before), &before, &content);
        file.as_file().set_len(1_000_100).unwrap();
        let lost = [at(1_000_000, 101), at(1_000_050, 60_000), at(1_000_100, 1), at(2_900_000, 4096)];
        for (result, extent) in read_all_of(&mut reader, &lost).into_iter().zip(lost) {
            let error = result.unwrap_err();
            assert_eq!(error.code(), Code::Damaged, "{io:?} {extent:?}: {error}");
        }
        let left = [at(999_000, 1100), at(0, 66_000)];
        check_same(&read_all_of(&mut reader, &left), &left, &content);
    }
}

#[test]
fn faults_are_ridden_out() {
    let content: Arc<[u8]> = content().into();
    for align in [1, ALIGN_BYTES] {
        for seed in 0..8 {
            let plan = FaultPlan {
                seed,
                error_per_1024: 20,
                interrupt_per_1024: 200,
                short_per_1024: 300,
                ..FaultPlan::default()
            };
            let memory = Memory::new(Arc::clone(&content), 4, align);
            let results =
                read_all(Box::new(Fault::new(Box::new(memory), plan)), Path::new("memory"), &extents());
            check_same(&results, &extents(), &content);
        }
    }
}

#[test]
fn a_broken_range_is_named() {
    let content: Arc<[u8]> = content().into();
    let plan = FaultPlan { broken: Some(100_000..100_001), ..FaultPlan::default() };
    let memory = Memory::new(Arc::clone(&content), 4, 1);
    let extents =
        [Extent { offset: 99_000, stored_bytes: 2000 }, Extent { offset: 100_001, stored_bytes: 10 }];
    let mut results =
        read_all(Box::new(Fault::new(Box::new(memory), plan)), Path::new("scan.trex"), &extents);
    assert_eq!(results.pop().unwrap().unwrap(), &content[100_001..100_011]);
    let error = results.pop().unwrap().unwrap_err();
    assert_eq!((error.code(), error.place()), (Code::Io, "scan.trex at byte 99000"));
}

#[test]
fn endless_interruptions_end() {
    let plan = FaultPlan { interrupt_per_1024: 1024, ..FaultPlan::default() };
    let memory = Memory::new(vec![0; 100].into(), 1, 1);
    let extent = [Extent { offset: 0, stored_bytes: 100 }];
    let results = read_all(Box::new(Fault::new(Box::new(memory), plan)), Path::new("memory"), &extent);
    assert_eq!(results[0].as_ref().unwrap_err().code(), Code::Io);
}

#[test]
fn dropping_with_reads_in_flight_waits_for_them() {
    let file = file_of(&content());
    for io in [IoChoice::Auto, IoChoice::Pread, IoChoice::Mmap] {
        let mut backend = open(file.path(), &IoOptions { io, depth: 16, ..IoOptions::default() }).unwrap();
        for index in 0..16_u32 {
            let staging = StagingBuffer::new(64 << 10).unwrap();
            let offset = u64::from(index) * (64 << 10);
            backend.submit(RawRead { tag: index, offset, at: 0, bytes: 64 << 10, failures: 0, staging });
        }
        backend.complete(Wait::No, &mut Vec::new());
        drop(backend);
    }
}

#[test]
fn delays_and_flips_follow_the_plan() {
    let plan = FaultPlan { flip_per_1024: 1024, delay: Duration::from_millis(2), ..FaultPlan::default() };
    let memory = Memory::new(vec![0; 100].into(), 1, 1);
    let extent = [Extent { offset: 0, stored_bytes: 100 }];
    let start = std::time::Instant::now();
    let results = read_all(Box::new(Fault::new(Box::new(memory), plan)), Path::new("memory"), &extent);
    assert!(start.elapsed() >= Duration::from_millis(2));
    let ones: u32 = results[0].as_ref().unwrap().iter().map(|byte| byte.count_ones()).sum();
    assert_eq!(ones, 1);
}

/// A ring over `source` whose kernel refuses after so many calls.
fn failing_ring(source: Source, depth: usize, enters: u32) -> Failover {
    let ring = Uring::new(source.clone(), depth, "a test".into()).unwrap();
    let mut failover = Failover::new(ring, source, 3);
    failover.ring.enters_left = Some(enters);
    failover
}

/// One call of `io_uring_enter` that failed left its reads in the ring's queue for ever: the next ones panicked, since
/// the queue was full, or were read as damaged pages.
#[test]
fn a_ring_that_fails_is_left_for_pread() {
    let content = content();
    let file = file_of(&content);
    let extents = extents();
    for direct in [DirectChoice::Auto, DirectChoice::Off] {
        for enters in [0, 1, 2, 3, 7, 15] {
            let (source, _) = open::open_source(file.path(), direct).unwrap();
            let failover = failing_ring(source, 8, enters);
            let mut reader = Reader::new(Box::new(failover), file.path());
            let results = read_all_of(&mut reader, &extents);
            check_same(&results, &extents, &content);
            let description = reader.describe();
            assert_eq!(description.backend, "pread", "{enters}");
            let notice = description.notice.as_deref().unwrap();
            assert!(
                notice.contains("io_uring failed") && notice.contains("Cannot allocate memory"),
                "{notice}"
            );
            assert_eq!((reader.in_flight(), reader.room()), (0, 8));
        }
    }
}

/// Reads that the kernel has taken and never ends: a pipe without a writer's word.
#[test]
fn buffers_that_the_kernel_keeps_are_not_given_to_others() {
    let (receiver, mut sender) = std::io::pipe().unwrap();
    // For the read that tries the ring.
    sender.write_all(&[7; ALIGN_BYTES]).unwrap();
    let file = Arc::new(std::fs::File::from(std::os::fd::OwnedFd::from(receiver)));
    let mut failover = failing_ring(Source { file, direct: false }, 4, 1);
    let mut done = Vec::new();
    let submit = |failover: &mut Failover, tag| {
        let staging = StagingBuffer::new(ALIGN_BYTES).unwrap();
        failover.submit(RawRead { tag, offset: 0, at: 0, bytes: ALIGN_BYTES, failures: 0, staging });
    };
    submit(&mut failover, 0);
    failover.complete(Wait::No, &mut done);
    submit(&mut failover, 1);
    failover.complete(Wait::One, &mut done);
    // The one that the kernel never took: pipes cannot be read at an offset, so it fails at once.
    assert_eq!((done.len(), failover.in_flight()), (1, 1));
    assert_eq!((done[0].read.tag, done[0].result.is_err()), (1, true));
    failover.complete(Wait::One, &mut done);
    // The other one, after a second, with another buffer.
    assert_eq!((done.len(), failover.in_flight(), failover.ring.in_flight()), (2, 0, 0));
    let RawCompletion { read, result } = done.pop().unwrap();
    assert_eq!((read.tag, result.is_err()), (0, true));
    sender.write_all(&[9; ALIGN_BYTES]).unwrap();
    std::thread::sleep(Duration::from_millis(20));
    failover.complete(Wait::No, &mut done);
    assert!(read.staging.iter().all(|&byte| byte == 0), "the kernel wrote to a buffer that was given back");
    assert_eq!(failover.ring.set_aside(), 0, "the buffer was waited for");
}

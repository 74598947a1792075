//! Clusters that are unpacked on demand, against a page that was unpacked whole.

use super::*;
use crate::cluster::{ArrivingPage, UnpackError, unpack};
use crate::io::ALIGN_BYTES;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Unpacks as a pool does, and counts what is damaged.
#[derive(Default)]
struct CountingUnpacker {
    asked: AtomicUsize,
    damaged: AtomicUsize,
}

/// Materials of a model that has them all.
const ALL_MATERIALS: usize = 1 << 16;

impl Unpack for CountingUnpacker {
    fn is_unpacked_later(&self, _page: u32) -> bool {
        true
    }

    fn unpack(&self, page: u32, frame: SharedFrame<'_>, cluster: usize) {
        assert_eq!(page, 7);
        self.asked.fetch_add(1, Ordering::Relaxed);
        if unpack(frame, cluster, ALL_MATERIALS, &|_| true).is_err() {
            self.damaged.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// A frame of whole words, so that it begins at a multiple of 4.
fn frame() -> Vec<u64> {
    vec![0xa5a5_a5a5_a5a5_a5a5; FRAME_BYTES / 8]
}

/// The words that lead to the clusters of a frame, in the order of a walk.
fn words(view: &FrameView<'_>) -> Vec<FrameRef> {
    let mut found = Vec::new();
    let mut stack: Vec<FrameRef> = (0..view.root_count()).rev().map(|slot| view.root(slot)).collect();
    while let Some(at) = stack.pop() {
        if at.is_cluster() {
            found.push(at);
            continue;
        }
        let children: Vec<FrameRef> = view.node(at).words().map(FrameRef).collect();
        stack.extend(children.into_iter().rev());
    }
    found
}

/// So many clusters of all kinds.
fn clusters(count: u64) -> Vec<ClusterMesh> {
    (0..count)
        .map(|i| match i % 3 {
            0 => sheet(7, 8, 90 + i as i64),
            1 => tangle(60, [14; 3], i),
            _ => tangle(20, [34, 3, 34], i),
        })
        .collect()
}

/// A page of many clusters: seven under each node of a chain.
fn long_page(clusters: Vec<ClusterMesh>) -> PageContent {
    let count = clusters.len().div_ceil(7);
    let node = |at: usize| {
        let own = (7 * at..clusters.len().min(7 * at + 7)).map(|index| PageRef::Cluster(index as u16));
        own.chain((at + 1 < count).then_some(PageRef::Node(at as u16 + 1))).collect()
    };
    let nodes = (0..count).map(node).collect();
    PageContent { roots: vec![PageRef::Node(0)], nodes, clusters }
}

#[test]
fn clusters_come_in_any_order_as_in_a_page_unpacked_whole() {
    let page = long_page(clusters(24));
    let (packed, _) = page.encode();
    let whole = install_twice(&packed).unwrap();
    let whole_words = words(&FrameView::new(&whole));
    for stride in [1, 5, 7, 11, 13, 23] {
        let (mut memory, unpacker) = (frame(), CountingUnpacker::default());
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut memory);
        ArrivingPage::read(&packed).unwrap().install((LATTICE_BITS, ALL_MATERIALS), bytes).unwrap();
        let view = FrameView::new(Frame::of_page(SharedFrame::new(bytes), 7, &unpacker));
        let first = words(&view);
        assert!(
            first.iter().all(|at| at.is_packed()),
            "some clusters are unpacked before they are asked for"
        );
        for step in 0..24 {
            let index = step * stride % 24;
            let expected = FrameView::new(&whole).cluster(whole_words[index]).unwrap();
            // By a word from before, and by the one that stands there now.
            for at in [first[index], words(&view)[index]] {
                let cluster = view.cluster(at).unwrap();
                assert_eq!(cluster.bytes(), expected.bytes(), "cluster {index}");
            }
            assert!(!words(&view)[index].is_packed());
        }
        let asked = unpacker.asked.load(Ordering::Relaxed);
        assert!((24..=48).contains(&asked), "{asked}");
        assert_eq!(view.used_bytes(), FrameView::new(&whole).used_bytes());
        assert_eq!(unpacker.damaged.load(Ordering::Relaxed), 0);
    }
}

/// A page of which the heap comes to the packed page on the way.
fn full_page() -> PageContent {
    let mut all = Vec::new();
    while long_page(all.clone()).frame_bytes() < FRAME_BYTES - 4096 {
        all.push(sheet(8, 8, 1000 + all.len() as i64));
    }
    long_page(all)
}

#[test]
fn a_full_page_is_unpacked_by_many_threads() {
    let page = full_page();
    let (packed, _) = page.encode();
    let (mut memory, unpacker) = (frame(), CountingUnpacker::default());
    let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut memory);
    ArrivingPage::read(&packed).unwrap().install((LATTICE_BITS, ALL_MATERIALS), bytes).unwrap();
    let view = FrameView::new(Frame::of_page(SharedFrame::new(bytes), 7, &unpacker));
    assert_eq!(view.triangle_count(), page.triangle_count());
    let first = words(&view);
    std::thread::scope(|scope| {
        for thread in 0..4 {
            let (view, first, page) = (&view, &first, &page);
            scope.spawn(move || {
                for step in 0..first.len() {
                    let index = (step * 7 + thread * 3) % first.len();
                    assert_eq!(view.cluster(first[index]).unwrap().decode(), page.clusters[index]);
                }
            });
        }
    });
    assert_eq!(view.used_bytes(), page.frame_bytes());
}

/// What has not been asked for is not written, and a cluster that finds no memory is not lost.
#[test]
fn memory_is_asked_for_before_it_is_written() {
    for page in [long_page(clusters(24)), full_page()] {
        let (packed, _) = page.encode();
        let mut memory = frame();
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut memory);
        let arriving = ArrivingPage::read(&packed).unwrap();
        let [head, tail] = arriving.ends();
        arriving.install((LATTICE_BITS, ALL_MATERIALS), bytes).unwrap();
        let room = std::cell::Cell::new(head.next_multiple_of(ALIGN_BYTES));
        let tail_at = (FRAME_BYTES - tail) / ALIGN_BYTES * ALIGN_BYTES;
        assert!(room.get() < tail_at, "nothing is left to ask for");
        for index in 0..page.clusters.len() {
            for is_there in [false, true] {
                let asked = std::cell::Cell::new(false);
                let grow = |to: usize| {
                    assert!(room.get() <= to && to <= tail_at, "{to} after {}", room.get());
                    asked.set(true);
                    if is_there {
                        room.set(to.next_multiple_of(ALIGN_BYTES).min(tail_at));
                    }
                    is_there
                };
                let unpacked = unpack(SharedFrame::new(bytes), index, ALL_MATERIALS, &grow);
                let refused = asked.get() && !is_there;
                assert_eq!(unpacked, if refused { Err(UnpackError::NoRoom) } else { Ok(()) });
                assert!(bytes[room.get().min(tail_at)..tail_at].iter().all(|byte| *byte == 0xa5));
            }
        }
        let view = FrameView::new(&*bytes);
        let mut found = Vec::new();
        view.for_each_cluster(|cluster| found.push(cluster.decode()));
        assert!(found == page.clusters);
    }
}

#[test]
fn triangles_are_found_by_their_number() {
    let page = page(clusters(9));
    let frame = installed(&page);
    let view = FrameView::new(&frame);
    let mut first = 0;
    for cluster in &page.clusters {
        let count = cluster.triangles.len();
        for index in [first, first + count - 1] {
            assert_eq!(view.cluster_with(index).unwrap().decode(), *cluster);
        }
        first += count;
    }
    assert!(view.cluster_with(first).is_none());
}

/// A page that no decoder believes to its end: what is damaged is lost and told, the rest is there.
#[test]
fn a_damaged_cluster_is_lost_alone() {
    let page = page(clusters(6));
    let (mut packed, _) = page.encode();
    // The last byte is of the last cluster: the zeros behind its bits, or bits of a vertex.
    let end = packed.len() - 3;
    packed[end..].fill(0xff);
    let whole = install_twice(&packed).unwrap_err();
    let (mut memory, unpacker) = (frame(), CountingUnpacker::default());
    let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut memory);
    ArrivingPage::read(&packed).unwrap().install((LATTICE_BITS, ALL_MATERIALS), bytes).unwrap();
    let shared = SharedFrame::new(bytes);
    let view = FrameView::new(Frame::of_page(shared, 7, &unpacker));
    let mut found = Vec::new();
    view.for_each_cluster(|cluster| found.push(cluster.decode()));
    assert_eq!(found, page.clusters[..5], "{whole}");
    assert!(view.cluster(words(&view)[5]).is_none());
    assert_eq!(unpacker.damaged.load(Ordering::Relaxed), 1, "told once");
}

/// A cluster with a material that the model has not is damaged.
#[test]
fn materials_are_known_before_a_cluster_is_traced() {
    let page = page(vec![sheet(2, 2, 9)]);
    let (packed, _) = page.encode();
    for (material_count, expected) in
        [(8, Ok(())), (7, Err("a cluster has a material that the model has not"))]
    {
        let mut memory = frame();
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut memory);
        ArrivingPage::read(&packed).unwrap().install((LATTICE_BITS, material_count), bytes).unwrap();
        let expected = expected.map_err(UnpackError::Damaged);
        assert_eq!(unpack(SharedFrame::new(bytes), 0, material_count, &|_| true), expected);
    }
}

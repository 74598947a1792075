//! Boxes are conservative: every box of a file in its resident form (nodes of the top tree, nodes of pages, leaf
//! boxes as installed) holds every corner of every triangle below it, in whole numbers of 128 bits.
//!
//! Planes are read as `docs/format.md` and `ClusterView` define them, with none of the store's own arithmetic.
//! The worst error is how far a plane lies outside, in its own steps: below 1 for its own rounding, and as much as
//! the boxes below it have moved, which are no coarser. Pages tell the sides of their clusters in seven bits: there it
//! is how far a plane lies outside of these.

use super::graded_box;
use super::shapes::{needles, placed};
use crate::command::said;
use crate::random::Random;
use crate::support::{Built, build_options, build_source, source};
use trex_store::TriangleSource;
use trex_store::build::{BuildOptions, Precision};
use trex_store::cluster::{ChildBoxes, ClusterView, FrameRef, FrameView, TopRef, TreeNode};
use trex_store::layout::FRAME_BYTES;

/// Least and greatest corner.
type Bounds = [[i128; 3]; 2];

const NOTHING: Bounds = [[i128::MAX; 3], [i128::MIN; 3]];

fn join(a: Bounds, b: Bounds) -> Bounds {
    [std::array::from_fn(|i| a[0][i].min(b[0][i])), std::array::from_fn(|i| a[1][i].max(b[1][i]))]
}

/// What is below a box: exact, and as it is told.
#[derive(Clone, Copy)]
struct Inside {
    exact: Bounds,
    told: Bounds,
}

impl Inside {
    fn join(self, other: Inside) -> Inside {
        Inside { exact: join(self.exact, other.exact), told: join(self.told, other.told) }
    }
}

/// The side of a cluster as its page tells it: the highest seven bits, and all below them set.
fn told_side(side: i128) -> i128 {
    let lost = (128 - side.leading_zeros()).saturating_sub(7);
    (((side >> lost) + 1) << lost) - 1
}

/// A walk over all boxes of a file.
struct Walk<'a> {
    name: &'a str,
    built: &'a Built,
    frame: Vec<u8>,
    page: Option<u32>,
    triangle_count: usize,
    box_count: usize,
    /// Most that a plane lies outside of what it bounds, in its steps.
    worst: f64,
}

impl Walk<'_> {
    /// The box holds `inside`; planes have these steps.
    fn holds(&mut self, planes: Bounds, Inside { exact, told }: Inside, steps: [i128; 3]) {
        self.box_count += 1;
        for a in 0..3 {
            let outside = |inside: Bounds| [inside[0][a] - planes[0][a], planes[1][a] - inside[1][a]];
            assert!(
                outside(exact).iter().all(|&o| o >= 0),
                "{}: {planes:?} does not hold {exact:?}",
                self.name
            );
            let outside = outside(told);
            let most = *outside.iter().max().unwrap() as f64 / steps[a] as f64;
            self.worst = self.worst.max(most);
        }
    }

    fn children(
        &mut self,
        node: &ChildBoxes,
        words: &[u32],
        mut below: impl FnMut(&mut Self, u32) -> Inside,
    ) -> Inside {
        let shift = self.built.file.superblock().node_shift;
        let mut all = Inside { exact: NOTHING, told: NOTHING };
        for i in 0..usize::from(node.child_count) {
            let inside = below(self, words[i]);
            let plane = |a: usize, q: u16| {
                (i128::from(node.origin[a]) + (i128::from(q) << node.exponent[a])) << shift
            };
            let planes = [
                std::array::from_fn(|a| plane(a, node.lo[a][i])),
                std::array::from_fn(|a| plane(a, node.hi[a][i])),
            ];
            self.holds(planes, inside, node.exponent.map(|e| 1 << (u32::from(e) + shift)));
            all = all.join(inside);
        }
        all
    }

    fn top(&mut self, word: u32) -> Inside {
        match TopRef::from_word(word) {
            TopRef::Node(index) => {
                let node = self.built.file.top()[index as usize];
                self.children(&node.boxes, &node.child, Walk::top)
            }
            TopRef::Page { page, slot } => {
                if self.page.replace(page) != Some(page) {
                    let mut buffers = [Vec::new(), Vec::new()];
                    self.built.file.read_page(page, &mut self.frame, &mut buffers).unwrap();
                }
                let root = FrameView::new(&self.frame).root(slot as usize);
                let Inside { exact, .. } = self.in_page(root);
                Inside { exact, told: exact }
            }
        }
    }

    fn in_page(&mut self, at: FrameRef) -> Inside {
        if !at.is_cluster() {
            let node = FrameView::new(&self.frame).node(at);
            let (boxes, words): (_, Vec<u32>) = (*node.boxes(), node.words().collect());
            return self.children(&boxes, &words, |walk, word| walk.in_page(FrameRef(word)));
        }
        let frame = std::mem::take(&mut self.frame);
        let exact = self.cluster(&FrameView::new(&frame).cluster(at).unwrap());
        self.frame = frame;
        let end = (1 << self.built.file.superblock().lattice_bits) - 1;
        let hi = |a: usize| (exact[0][a] + told_side(exact[1][a] - exact[0][a])).min(end);
        Inside { exact, told: [exact[0], std::array::from_fn(hi)] }
    }

    fn cluster(&mut self, cluster: &ClusterView<'_>) -> Bounds {
        let (base, shift, planes) = (cluster.base(), cluster.leaf_shift(), cluster.leaf_planes());
        let mut all = NOTHING;
        for leaf in 0..cluster.leaf_count() {
            let mut inside = NOTHING;
            for place in 0..cluster.leaf_indices(leaf).shape.triangle_count() {
                for corner in cluster.triangle(leaf, place) {
                    inside = join(inside, [corner.map(i128::from); 2]);
                }
                self.triangle_count += 1;
            }
            let plane = |a: usize, cell: i128| i128::from(base[a]) + (cell << shift[a]);
            let lo = std::array::from_fn(|a| plane(a, i128::from(planes[a][leaf])));
            let hi = std::array::from_fn(|a| plane(a, i128::from(planes[3 + a][leaf]) + 1) - 1);
            self.holds([lo, hi], Inside { exact: inside, told: inside }, shift.map(|s| 1 << s));
            all = join(all, inside);
        }
        all
    }
}

fn check(source: &mut dyn TriangleSource, precision: Precision) {
    let built = build_source(source, &BuildOptions { precision, ..build_options() });
    let name = format!("boxes of {}, {precision:?}", source.name());
    let frame = vec![0; FRAME_BYTES];
    let mut walk =
        Walk { name: &name, built: &built, frame, page: None, triangle_count: 0, box_count: 0, worst: 0.0 };
    let Inside { exact: all, .. } = walk.top(built.file.superblock().root);
    let block = built.file.superblock();
    assert_eq!(all, block.lattice_bounds.map(|corner| corner.map(i128::from)), "{name}: the model's box");
    assert_eq!(walk.triangle_count as u64, block.triangle_count, "{name}: triangles under the root");
    said(&format!(
        "{name}: {} bits, {} wide clusters, {} boxes hold what is below, at most {:.3} steps outside",
        block.lattice_bits, block.wide_cluster_count, walk.box_count, walk.worst
    ));
    assert!(walk.worst < 2.0, "{name}: a plane lies {} steps outside", walk.worst);
}

#[test]
fn every_box_holds_what_is_below_it() {
    for kind in ["isosurface", "pipes", "soup"] {
        for precision in [Precision::Default, Precision::GridBits(24), Precision::GridBits(40)] {
            check(&mut *source(&format!("gen:{kind}:40k:6")), precision);
        }
    }
    let mut rng = Random::seeded(5);
    for triangles in [graded_box(23), graded_box(39), needles(2000, [1 << 38, 27_488, 1 << 20], &mut rng)] {
        let mut shape = placed("box or needles", &triangles, [0.0; 3], 1.0);
        check(&mut shape, Precision::Error(0.5));
    }
}

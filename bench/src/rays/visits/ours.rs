//! Our tree as rays meet it: the boxes of top nodes, page nodes, clusters and leaves, read from tables and frames.

use super::tree::{Box3, Level, NOTHING, Part, Tree, corners_of};
use trex_render::AllResident;
use trex_store::PageFile;
use trex_store::cluster::{FrameRef, FrameView, TopRef, TreeNode};

/// The tree of a file, in the making.
pub(super) struct FileTree<'a> {
    file: &'a PageFile,
    pages: &'a AllResident,
    tree: Tree,
}

impl FileTree<'_> {
    /// The tree of `file`.
    pub(super) fn tree(file: &PageFile, pages: &AllResident) -> Tree {
        let nowhere = Part { bounds: NOTHING, level: Level::Top, first: 0, count: 0 };
        let tree = Tree { parts: vec![nowhere], triangles: Vec::new() };
        let mut ours = FileTree { file, pages, tree };
        let bounds = file.superblock().lattice_bounds.map(|corner| corner.map(|q| q as f32));
        ours.top(0, bounds, file.superblock().root);
        ours.tree
    }

    /// Fills part `at` with what a word of the top tree leads to.
    fn top(&mut self, at: usize, bounds: Box3, word: u32) {
        match TopRef::from_word(word) {
            TopRef::Node(index) => {
                let node = self.file.top()[index as usize];
                self.node((at, bounds, Level::Top), &node, FileTree::top);
            }
            TopRef::Page { page, slot } => {
                let frame = FrameView::new(self.pages.frame(page));
                let root = frame.root(slot as usize);
                self.in_page((frame, at), bounds, root);
            }
        }
    }

    fn in_page(&mut self, (frame, at): (FrameView<'_>, usize), bounds: Box3, word: FrameRef) {
        if word.is_cluster() {
            return self.cluster(frame, at, bounds, word);
        }
        let below = |ours: &mut Self, at, bounds, word| ours.in_page((frame, at), bounds, FrameRef(word));
        self.node((at, bounds, Level::Node), frame.node(word), below);
    }

    fn node(
        &mut self,
        (at, bounds, level): (usize, Box3, Level),
        node: &impl TreeNode,
        mut below: impl FnMut(&mut Self, usize, Box3, u32),
    ) {
        let first = self.reserve((at, bounds, level), usize::from(node.boxes().child_count));
        let shift = self.file.superblock().node_shift;
        for i in 0..usize::from(node.boxes().child_count) {
            let child = node.boxes().child_box(i, shift);
            below(self, first + i, [child.lo, child.hi].map(|corner| corner.map(|q| q as f32)), node.word(i));
        }
    }

    /// Sets part `at`, with room for so many children; gives the first of these.
    fn reserve(&mut self, (at, bounds, level): (usize, Box3, Level), count: usize) -> usize {
        let first = self.tree.parts.len();
        self.tree.parts[at] = Part { bounds, level, first: first as u32, count: count as u32 };
        let nowhere = Part { bounds: NOTHING, level: Level::Leaf, first: 0, count: 0 };
        self.tree.parts.resize(first + count, nowhere);
        first
    }

    fn cluster(&mut self, frame: FrameView<'_>, at: usize, bounds: Box3, word: FrameRef) {
        let cluster = frame.cluster(word).expect("a page that was unpacked whole");
        let first = self.reserve((at, bounds, Level::Cluster), cluster.leaf_count());
        let (base, shift, planes) = (cluster.base(), cluster.leaf_shift(), cluster.leaf_planes());
        for leaf in 0..cluster.leaf_count() {
            let lo = std::array::from_fn(|a| (base[a] + (i64::from(planes[a][leaf]) << shift[a])) as f32);
            let end = |a: usize| base[a] + ((i64::from(planes[3 + a][leaf]) + 1) << shift[a]) - 1;
            let bounds = [lo, std::array::from_fn(|a| end(a) as f32)];
            let (count, triangles) =
                (cluster.leaf_indices(leaf).shape.triangle_count(), self.tree.triangles.len() as u32);
            self.tree.parts[first + leaf] =
                Part { bounds, level: Level::Leaf, first: triangles, count: count as u32 };
            let corners = (0..count).map(|place| corners_of(cluster.triangle(leaf, place)));
            self.tree.triangles.extend(corners);
        }
    }
}

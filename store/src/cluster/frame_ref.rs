//! `FrameRef`: the word of a frame that leads to a node or a cluster of it.

/// Where a node's child stands in the same frame: a byte offset and whether it is a cluster; of a cluster that is
/// packed its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRef(pub u32);

impl FrameRef {
    const CLUSTER_FLAG: u32 = 1 << 31;
    const PACKED_FLAG: u32 = 1 << 30;
    /// A cluster that could not be unpacked: rays go on as if it were empty.
    pub(super) const LOST: FrameRef = FrameRef(u32::MAX);

    /// A node at this byte offset.
    pub fn node(offset: usize) -> FrameRef {
        FrameRef(offset as u32)
    }

    /// A cluster at this byte offset.
    pub fn cluster(offset: usize) -> FrameRef {
        FrameRef(offset as u32 | FrameRef::CLUSTER_FLAG)
    }

    /// A cluster of this number, which is packed.
    pub(super) fn packed(index: usize) -> FrameRef {
        FrameRef(index as u32 | FrameRef::CLUSTER_FLAG | FrameRef::PACKED_FLAG)
    }

    /// True for a cluster.
    #[inline(always)]
    pub fn is_cluster(self) -> bool {
        self.0 & FrameRef::CLUSTER_FLAG != 0
    }

    /// True for a cluster that is packed, or lost.
    #[inline(always)]
    pub fn is_packed(self) -> bool {
        self.0 >> 30 == 3
    }

    /// The byte offset in the frame; of a cluster that is packed its number.
    #[inline(always)]
    pub fn offset(self) -> usize {
        (self.0 & !(FrameRef::CLUSTER_FLAG | FrameRef::PACKED_FLAG)) as usize
    }
}

//! `Record`: what one material brings to one leaf.

/// What one material brings to one leaf.
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(crate) struct Record {
    /// The leaf's key (see `leaf_key`) over 16 bits of the material: the order of records.
    pub(super) order: u64,
    /// Subvoxels touched: bit `x + 4 y + 16 z`.
    pub(crate) bitmap: u64,
    /// Area inside of the leaf, in squares of its side.
    pub(crate) area: f32,
    /// Sum of unit normals weighted by area.
    pub(crate) normal: [f32; 3],
}

impl Record {
    /// An empty one.
    pub(super) fn at(key: u64, material: u16) -> Record {
        Record { order: key << 16 | u64::from(material), ..Record::default() }
    }

    /// The leaf.
    pub(super) fn key(&self) -> u64 {
        self.order >> 16
    }

    /// The material.
    pub(super) fn material(&self) -> u16 {
        self.order as u16
    }

    /// Sums another record of the same leaf.
    pub(crate) fn add(&mut self, other: &Record) {
        self.bitmap |= other.bitmap;
        self.area += other.area;
        (0..3).for_each(|a| self.normal[a] += other.normal[a]);
    }
}

//! A window of recent vertices: finds the index of a position that was met not too long ago.
//!
//! Invariants: 1. memory is [`Window::BYTES`], whatever the stream; 2. the answers depend on the sequence of
//! vertices only, so a second pass gets the same indices; 3. a vertex found has the same position to the bit, and the
//! same colour and normal.

use crate::dice::mix;
use trex_store::CornerAttributes;
use trex_store::cluster::{Colour, Normal};

/// Slots, each overwritten by the next position that falls there: 20 MiB. Streams are coherent, so most shared
/// vertices come back before they are forgotten.
const SLOTS: usize = 1 << 19;

/// Recent positions and their indices.
pub(super) struct Window {
    slots: Vec<Slot>,
    next: u64,
}

#[derive(Clone, Copy)]
struct Slot {
    bits: [u64; 3],
    /// The index, and the colour above it; all ones: none.
    tag: u64,
    normal: Normal,
}

/// A vertex as a file has it.
#[derive(Clone, Copy)]
pub(super) struct WindowVertex {
    pub(super) position: [f64; 3],
    pub(super) colour: Colour,
    pub(super) normal: Normal,
}

impl WindowVertex {
    /// The corners of a triangle.
    pub(super) fn of_triangle(corners: &[[f64; 3]; 3], attributes: &CornerAttributes) -> [WindowVertex; 3] {
        let CornerAttributes { colours, normals } = attributes;
        [0, 1, 2].map(|corner| WindowVertex {
            position: corners[corner],
            colour: colours[corner],
            normal: normals[corner],
        })
    }
}

/// Bits of an index.
const INDEX_BITS: u32 = 40;

/// What the window says about a position.
pub(super) enum WindowEntry {
    /// Never met, or forgotten: it has this new index.
    New(u64),
    /// Met with this index.
    Known(u64),
}

impl Window {
    /// Memory of a window.
    pub(super) const BYTES: u64 = (SLOTS * size_of::<Slot>()) as u64;

    pub(super) fn new() -> Window {
        Window { slots: vec![Slot { bits: [0; 3], tag: u64::MAX, normal: Normal::NONE }; SLOTS], next: 0 }
    }

    /// Count of indices given.
    pub(super) fn vertex_count(&self) -> u64 {
        self.next
    }

    /// Looks a vertex up, and remembers it.
    pub(super) fn place(&mut self, vertex: WindowVertex) -> WindowEntry {
        let WindowVertex { position, colour: [r, g, b], normal } = vertex;
        let bits = position.map(f64::to_bits);
        let colour = u64::from(u32::from_le_bytes([r, g, b, 0]));
        let key = mix(bits[0] ^ bits[1].rotate_left(21) ^ bits[2].rotate_left(42));
        let slot = &mut self.slots[key as usize % SLOTS];
        if slot.tag != u64::MAX
            && slot.bits == bits
            && slot.tag >> INDEX_BITS == colour
            && slot.normal == normal
        {
            return WindowEntry::Known(slot.tag & ((1 << INDEX_BITS) - 1));
        }
        let index = self.next;
        assert!(index < (1 << INDEX_BITS) - 1, "more vertices than any format has");
        *slot = Slot { bits, tag: index | colour << INDEX_BITS, normal };
        self.next += 1;
        WindowEntry::New(index)
    }
}

impl WindowEntry {
    /// The index, new or not.
    pub(super) fn index(&self) -> u64 {
        match *self {
            WindowEntry::New(index) | WindowEntry::Known(index) => index,
        }
    }
}

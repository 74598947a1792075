//! SIMD of C-rays: the AVX2 kernel, packets of eight rays, and the ways in.

mod avx2;
mod entry;
mod packet;

pub(super) use entry::{is_available, packet, trace};
pub(super) use packet::{PACKET_RAYS, PacketRoom};

//! The ways into the AVX2 kernel: a ray, a packet, each compiled for its features as a whole.
//!
//! Invariant: who calls has asked [`is_available`] once, when the arithmetic was chosen.
#![allow(unsafe_code)]

use super::avx2::Avx2;
use super::packet::{PacketRoom, trace_packet};
use crate::trace::Ray;
use crate::trace::bvh::{Goal, LatticeScene, MissingPages, RayEnd, trace_ray};
use crate::trace::pages::Pages;
use crate::trace::stack::Stack;

/// True where the machine has what the kernel uses.
pub(in crate::trace) fn is_available() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") && is_x86_feature_detected!("bmi2")
}

/// [`trace_ray`] with this kernel.
pub(in crate::trace) fn trace<P: Pages, G: Goal>(
    scene: &LatticeScene,
    pages: &mut P,
    stack: &mut Stack,
    ray: &Ray,
    missing: &mut MissingPages,
) -> Option<RayEnd> {
    // SAFETY: `PagedMesh` chooses this arithmetic only where `is_available`.
    unsafe { trace_with_features::<P, G>(scene, pages, stack, ray, missing) }
}

#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn trace_with_features<P: Pages, G: Goal>(
    scene: &LatticeScene,
    pages: &mut P,
    stack: &mut Stack,
    ray: &Ray,
    missing: &mut MissingPages,
) -> Option<RayEnd> {
    trace_ray::<Avx2, P, G>(scene, pages, stack, ray, missing)
}

/// [`trace_packet`] with this kernel.
pub(in crate::trace) fn packet<P: Pages, G: Goal>(
    scene: &LatticeScene,
    pages: &mut P,
    stack: &mut Stack,
    rays: &[Ray],
    room: &mut PacketRoom,
) {
    // SAFETY: `PagedMesh` chooses this arithmetic only where `is_available`.
    unsafe { packet_with_features::<P, G>(scene, pages, stack, rays, room) }
}

#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn packet_with_features<P: Pages, G: Goal>(
    scene: &LatticeScene,
    pages: &mut P,
    stack: &mut Stack,
    rays: &[Ray],
    room: &mut PacketRoom,
) {
    // SAFETY: the features are there.
    unsafe { trace_packet::<P, G>(scene, pages, stack, rays, room) }
}

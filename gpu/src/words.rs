//! The words that shaders see: parameters of a batch, outcomes. Rays and answers are those of `trex_render`.
//!
//! Invariants: 1. every field is a word of 32 bits; 2. offsets are those of the WGSL structs of the same names, and
//! numbers those of its constants: tests compare both.

use bytemuck::{Pod, Zeroable};
use trex_render::{GAnswer, GRay};

/// Words of the answer of a ray that is no shadow ray; of a shadow ray it is one.
pub(crate) const SURFACE_WORDS: usize = size_of::<GAnswer>() / 4;
/// Bytes of a ray.
pub(crate) const RAY_BYTES: usize = size_of::<GRay>();

/// The outcome of a walk that took more steps than it may: the processor answers.
pub(crate) const UNANSWERED: u32 = 3;
/// From this bit on an outcome holds the page that a ray wants, plus 1; 0 for none.
pub(crate) const WANT_SHIFT: u32 = 2;

/// The state of a page of the file in video memory: not there.
pub(crate) const PAGE_MISSING: u32 = 0;
/// Never to be had: it is damaged.
pub(crate) const PAGE_NEVER: u32 = 1;
/// This and more: in the slot of so many less.
pub(crate) const PAGE_SLOTS: u32 = 2;

/// Parameters of a batch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Params {
    /// Levels of nodes above the upper leaves.
    pub(crate) depth: u32,
    /// Index of the first of the last nodes.
    pub(crate) first_last: u32,
    /// Where the words of the last nodes begin in the payload.
    pub(crate) last_nodes_at: u32,
    /// 1 where leaves are whole cubes.
    pub(crate) is_whole: u32,
    /// Levels of leaves below the upper ones that rays may ask.
    pub(crate) finer: u32,
    /// Rays of the batch.
    pub(crate) ray_count: u32,
    /// How many of them, the first, are shadow rays.
    pub(crate) shadow_count: u32,
    /// Most steps of a walk.
    pub(crate) steps_max: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::KERNELS;
    use std::mem::offset_of;

    /// Offsets of the members of a WGSL struct, by name.
    fn offsets(name: &str) -> Vec<(String, u32)> {
        let module = naga::front::wgsl::parse_str(&KERNELS[0].text()).unwrap();
        let mut types = module.types.iter().filter(|(_, ty)| ty.name.as_deref() == Some(name));
        let (_, ty) = types.next().unwrap_or_else(|| panic!("WGSL has no struct {name}"));
        let naga::TypeInner::Struct { members, .. } = &ty.inner else { panic!("{name} is no struct") };
        members.iter().map(|member| (member.name.clone().unwrap(), member.offset)).collect()
    }

    fn named(fields: &[(&str, usize)]) -> Vec<(String, u32)> {
        fields.iter().map(|&(name, at)| (name.to_owned(), at as u32)).collect()
    }

    #[test]
    fn structs_lie_as_shaders_read_them() {
        macro_rules! at {
            ($ty:ty: $($field:ident),*) => { [$((stringify!($field), offset_of!($ty, $field))),*] };
        }
        let params = at!(Params: depth, first_last, last_nodes_at, is_whole, finer, ray_count, shadow_count,
            steps_max);
        assert_eq!(offsets("Params"), named(&params));
        let [origin, direction] = [offset_of!(GRay, origin), offset_of!(GRay, direction)];
        let ray = [
            ("origin_x", origin),
            ("origin_y", origin + 4),
            ("origin_z", origin + 8),
            ("t_max", offset_of!(GRay, t_max)),
            ("direction_x", direction),
            ("direction_y", direction + 4),
            ("direction_z", direction + 8),
            ("bits", offset_of!(GRay, bits)),
            ("width", offset_of!(GRay, width)),
            ("spread", offset_of!(GRay, spread)),
        ];
        assert_eq!(offsets("GRay"), named(&ray));
        // What `surface_rays` writes word by word.
        let answer = at!(GAnswer: outcome, t, side, material, axis, normal);
        assert_eq!(answer.map(|(_, at)| at), [0, 4, 8, 12, 16, 20]);
    }

    /// The constants of the shaders, by name, against those of the Rust code.
    #[test]
    fn numbers_are_those_of_the_shaders() {
        use trex_render::GKind;
        let module = naga::front::wgsl::parse_str(&KERNELS[1].text()).unwrap();
        let value = |name: &str| {
            let mut all = module.constants.iter().filter(|(_, c)| c.name.as_deref() == Some(name));
            let (_, constant) = all.next().unwrap_or_else(|| panic!("WGSL has no constant {name}"));
            match module.global_expressions[constant.init] {
                naga::Expression::Literal(naga::Literal::U32(value)) => value,
                ref other => panic!("{name} is {other:?}"),
            }
        };
        let expected = [
            ("BLOCKED", GAnswer::BLOCKED),
            ("NOTHING", GAnswer::NOTHING),
            ("MET", GAnswer::MET),
            ("UNANSWERED", UNANSWERED),
            ("WANT_SHIFT", WANT_SHIFT),
            ("KIND_SHADOW", GKind::Shadow as u32),
            ("KIND_GATHER", GKind::Gather as u32),
            ("KIND_PHOTON", GKind::Photon as u32),
            ("PAGE_MISSING", PAGE_MISSING),
            ("PAGE_NEVER", PAGE_NEVER),
            ("PAGE_SLOTS", PAGE_SLOTS),
            ("PATH_LEVELS", trex_store::octree::MAX_DEPTH as u32 + 1),
            ("OPEN_LEVELS", trex_store::octree::MAX_FINER as u32 + 1),
        ];
        for (name, expected) in expected {
            assert_eq!(value(name), expected, "{name}");
        }
        assert_eq!(SURFACE_WORDS, 8);
    }
}

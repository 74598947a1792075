//! The keys of a picture, in one table: what a scene file, a flag or a page may say of it, and within which range.
//!
//! ```text
//! KEYS -> gate of RenderSettings -> scene files
//!      -> flags, their ranges and their help        (the command)
//!      -> the panel of the page                     (the viewer)
//!      -> the table of docs/scene.md                (trex-bench docs)
//! ```
//!
//! Invariant: a range, a unit and a name of a choice are written here and nowhere else. Defaults are those of a scene
//! that says nothing: [`Key::default_value`].

use super::camera::SIDE_MAX_PIXELS;
use super::key::{Choice, Elsewhere, Key, KeyKind};
use super::method::Method;

/// Most samples a pixel.
pub const SPP_MAX: u32 = 1_000_000_000;
/// Most rays of a kind that leave one surface point.
const RAYS_MAX: u64 = 4096;
/// Most photons of `full-gi`, which keeps each: their hits are numbered in 32 bits.
pub const TREE_PHOTONS_MAX: u64 = 1 << 30;
/// Greatest seed: TOML's numbers have a sign.
const SEED_MAX: u64 = i64::MAX as u64;

/// What a key is where nothing else is said: used by all methods.
const OF_ALL: Key = Key {
    name: "",
    title: "",
    unit: "",
    kind: KeyKind::Flag,
    is_used_by: |_| true,
    elsewhere: Elsewhere::Ignored,
    narrower: None,
    text: "",
};

/// Many keys at once.
pub static QUALITY: Key = Key {
    name: "quality",
    title: "Quality",
    kind: KeyKind::Choice(&[
        choice("draft", "Draft", "A look, in the shortest time that shows all light"),
        choice("normal", "Normal", "A picture to work with"),
        choice("reference", "Reference", "What others are measured by: path, for as long as it takes"),
    ]),
    text: "Sets many of the others at once, a trade of time for accuracy; those given beside it take precedence",
    ..OF_ALL
};
/// The way in which light is computed.
pub static INTEGRATOR: Key = Key {
    name: "integrator",
    title: "Light",
    kind: KeyKind::Choice(&[
        choice("direct", "Direct light", "Direct light and perfect mirrors on the exact mesh"),
        Choice {
            alias: Some("cpu-gi"),
            ..choice(
                "photon",
                "All light, photons and voxels",
                "All light but some caustics, by photons and voxels: what is seen and its mirrors on the exact \
                 mesh; also called cpu-gi, as all of it runs on the CPU",
            )
        },
        choice(
            "full-gi",
            "All light, photons on the mesh",
            "All light but some caustics, by photons in a kd-tree: everything on the exact mesh",
        ),
        choice("path", "All light, paths", "All light but some caustics, unbiased, on the exact mesh"),
        choice(
            "ao",
            "Ambient occlusion",
            "Ambient occlusion: white light from all sides on white surfaces, by voxels where the file has them",
        ),
        choice("debug-upper", "Voxels", "The voxels of the resident octree, as cubes"),
        choice("debug-lower", "Finest voxels", "The finest voxels, as cubes"),
        choice("debug-occluders", "Bitmaps", "The bitmaps of the voxels"),
        choice("debug-pages", "Pages", "The mesh, a colour per page"),
    ]),
    text: "How light is computed; for a file without voxels the default is direct",
    ..OF_ALL
};
/// The lamps.
pub static LIGHT: Key = Key {
    name: "light",
    title: "Lamps",
    kind: KeyKind::Choice(&[
        choice(
            "auto",
            "Those that show it",
            "Studio where the model has lamps of its own, the scene none, and these leave most of the opening view \
             dark; else scene. Decided once",
        ),
        choice(
            "scene",
            "Of scene and model",
            "Those of scene and model; where neither has any, a sun and a pale sky",
        ),
        choice(
            "studio",
            "With sun and sky",
            "Those of scene and model, with that sun and that sky beside them",
        ),
    ]),
    is_used_by: Method::computes_light,
    text: "What gives light",
    ..OF_ALL
};
/// Which way is up.
pub static UP: Key = Key {
    name: "up",
    title: "Up",
    kind: KeyKind::Choice(&[
        choice("auto", "As its box says", "+Y, unless the model is flat along Z alone"),
        choice("+X", "+X", "Along X"),
        choice("-X", "-X", "Against X"),
        choice("+Y", "+Y", "Along Y"),
        choice("-Y", "-Y", "Against Y"),
        choice("+Z", "+Z", "Along Z"),
        choice("-Z", "-Z", "Against Z"),
    ]),
    text: "Which way is up in the model: where its sun stands, if it has one, and how a camera that frames it is held",
    ..OF_ALL
};
/// Width and height.
pub static RESOLUTION: Key = Key {
    name: "resolution",
    title: "Size",
    unit: "pixels",
    kind: KeyKind::Pair { most: SIDE_MAX_PIXELS },
    text: "Width and height of the picture, pixels",
    ..OF_ALL
};
/// Samples a pixel.
pub static SPP: Key = Key {
    name: "spp",
    title: "Samples a pixel",
    unit: "samples",
    kind: KeyKind::Count { least: 1, most: SPP_MAX as u64 },
    text: "Samples per pixel",
    ..OF_ALL
};
/// Shadow rays.
pub static N_SHADOW: Key = Key {
    name: "n_shadow",
    title: "Shadow rays",
    unit: "rays",
    kind: KeyKind::Count { least: 0, most: RAYS_MAX },
    is_used_by: Method::computes_light,
    text: "Shadow rays per surface point, 0 for no direct light; with ao, rays that look around",
    ..OF_ALL
};
/// Gather rays.
pub static N_GATHER: Key = Key {
    name: "n_gather",
    title: "Gather rays",
    unit: "rays",
    kind: KeyKind::Count { least: 0, most: RAYS_MAX },
    is_used_by: Method::gathers,
    text: "Gather rays per surface point, 0 for no indirect light",
    ..OF_ALL
};
/// Photons.
pub static PHOTONS: Key = Key {
    name: "photons",
    title: "Photons",
    unit: "photons",
    kind: KeyKind::Count { least: 1, most: 1 << 40 },
    is_used_by: Method::gathers,
    narrower: Some((Method::FullGi, TREE_PHOTONS_MAX)),
    text: "Photons in all",
    ..OF_ALL
};
/// Photons of a look-up; one gives the distance, the others the light.
pub static K_NEAREST: Key = Key {
    name: "k_nearest",
    title: "Nearest photons",
    unit: "photons",
    kind: KeyKind::Count { least: 2, most: 1024 },
    is_used_by: |method| method == Method::FullGi,
    text: "Nearest photons from which the light of a surface point is estimated",
    ..OF_ALL
};
/// Photons through the exact mesh.
pub static BAKE: Key = Key {
    name: "bake",
    title: "Photons on the exact mesh",
    kind: KeyKind::Flag,
    is_used_by: |method| method == Method::Photon,
    elsewhere: Elsewhere::Refused,
    text: "Whether photons are traced on the exact mesh, not on the voxels: slower and more exact",
    ..OF_ALL
};
/// Caustics of points and suns.
pub static CAUSTICS: Key = Key {
    name: "caustics",
    title: "Caustics of points and suns",
    kind: KeyKind::Flag,
    is_used_by: |method| method == Method::Photon,
    elsewhere: Elsewhere::Refused,
    text: "Whether what points and suns bring over mirrors to a surface that is seen counts: as sharp as facets, with \
           twice the memory of light",
    ..OF_ALL
};
/// The begin of G-rays.
pub static NEAR: Key = Key {
    name: "near",
    title: "Rays begin",
    kind: KeyKind::Choice(&[
        choice("voxel", "A voxel off the surface", "A voxel off the surface"),
        choice(
            "contact",
            "On the mesh at contacts",
            "As voxel, but on the exact mesh where that is within the voxel of another surface",
        ),
        choice("exact", "On the exact mesh", "On the exact mesh, for the length of two leaves"),
    ]),
    is_used_by: |method| method.asks_voxels() && method.computes_light(),
    text: "Where shadow and gather rays begin",
    ..OF_ALL
};
/// The form of the model that stops shadow rays.
pub static SHADOWS: Key = Key {
    name: "shadows",
    title: "Shadows are of",
    kind: KeyKind::Choice(&[
        choice("mesh", "The exact mesh", "The exact mesh, which is asked where a ray meets a voxel"),
        choice("voxel", "The voxels", "The voxels: faster, and darker where thin things are close together"),
    ]),
    is_used_by: |method| method == Method::Photon,
    text: "What hides a light from a surface",
    ..OF_ALL
};
/// The form of voxels.
pub static OCCLUDERS: Key = Key {
    name: "occluders",
    title: "Voxels are",
    kind: KeyKind::Choice(&[
        choice("on", "As their bitmaps say", "The subvoxels of its bitmap"),
        choice("off", "Whole cubes", "The whole cube"),
    ]),
    is_used_by: |method| !matches!(method, Method::DebugUpper | Method::DebugLower),
    text: "What rays meet of a voxel",
    ..OF_ALL
};
/// The footprint rule.
pub static LOD_ERROR: Key = Key {
    name: "lod_error",
    title: "Pixel error",
    unit: "pixels",
    kind: KeyKind::Length { most: 1024.0 },
    is_used_by: |method| !method.shows_voxels(),
    text: "Pixels that a leaf voxel may cover where it stands for the mesh; 0 is the exact mesh everywhere",
    ..OF_ALL
};
/// Smoothing.
pub static FILTER: Key = Key {
    name: "filter",
    title: "Smooth indirect light",
    kind: KeyKind::Choice(&[choice("on", "On", "Smoothed"), choice("off", "Off", "As the samples come")]),
    is_used_by: Method::gathers,
    elsewhere: Elsewhere::Refused,
    text: "Whether indirect light is smoothed where pixels show the same surface",
    ..OF_ALL
};
/// Brightness of what is shown.
pub static EXPOSURE: Key = Key {
    name: "exposure",
    title: "Exposure",
    kind: KeyKind::Factor,
    text: "Factor on the light before it becomes a PNG; auto is decided once, by the surfaces that the opening view \
           shows",
    ..OF_ALL
};
/// Random numbers.
pub static SEED: Key = Key {
    name: "seed",
    title: "Seed",
    kind: KeyKind::Count { least: 0, most: SEED_MAX },
    text: "Seed of the random numbers",
    ..OF_ALL
};

/// All of them, in the order in which they are listed.
pub static KEYS: [&Key; 19] = [
    &QUALITY,
    &INTEGRATOR,
    &LIGHT,
    &UP,
    &RESOLUTION,
    &SPP,
    &N_SHADOW,
    &N_GATHER,
    &PHOTONS,
    &K_NEAREST,
    &BAKE,
    &CAUSTICS,
    &NEAR,
    &SHADOWS,
    &OCCLUDERS,
    &LOD_ERROR,
    &FILTER,
    &EXPOSURE,
    &SEED,
];

const fn choice(name: &'static str, title: &'static str, text: &'static str) -> Choice {
    Choice { name, alias: None, title, text }
}

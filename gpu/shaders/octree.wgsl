// Shared text 1 of 3: the octree, rays and answers as they lie in video memory, and how single words of them are read.
// Structs are those of `gpu/src/words.rs`; a test compares every offset. Sizes and numbers of the store's are set when a
// pipeline is made (`gpu/src/kernels.rs`).

// Invocations of a workgroup.
override WORKGROUP_RAYS: u32;
// Words of a frame.
override FRAME_WORDS: u32;
// Bits of a unit's word that are its page.
override PAGE_BITS: u32;
// Bits of each of the two components of a leaf's normal.
override OCTAHEDRAL_BITS: u32;
// True where steps of walks are counted: what measures asks for that.
override COUNTS_STEPS: bool;
// True where rays may go on into units; without them `params.finer` is 0, and the walk ends at upper leaves.
override HAS_UNITS: bool;

struct Params {
    // Levels of nodes above the upper leaves.
    depth: u32,
    // Index of the first of the last nodes.
    first_last: u32,
    // Where the words of the last nodes begin in `payload`, behind those of the leaves.
    last_nodes_at: u32,
    // 1 where leaves are whole cubes.
    is_whole: u32,
    // Levels of leaves below the upper ones that rays may ask; 0 where there are no units.
    finer: u32,
    // Rays, and how many of them, the first, are shadow rays.
    ray_count: u32,
    shadow_count: u32,
    // Most steps of a walk: what is beyond answers nothing, and goes to the processor.
    steps_max: u32,
}

struct GRay {
    origin_x: f32,
    origin_y: f32,
    origin_z: f32,
    t_max: f32,
    direction_x: f32,
    direction_y: f32,
    direction_z: f32,
    bits: u32,
    width: f32,
    spread: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rays: array<GRay>;
// Of shadow rays a word each; then eight of each other ray, in the order of `GAnswer`.
@group(0) @binding(2) var<storage, read_write> answers: array<u32>;
// Three words a node: mask, index of the first child.
@group(0) @binding(3) var<storage, read> nodes: array<u32>;
// Two words a leaf: its occluder bitmap.
@group(0) @binding(4) var<storage, read> bitmaps: array<u32>;
// A word a leaf, then three a last node: see `gpu/src/octree.rs`.
@group(0) @binding(5) var<storage, read> payload: array<u32>;
// A word a page of the file: PAGE_MISSING, PAGE_NEVER, or its slot in `frames` plus PAGE_SLOTS.
@group(0) @binding(6) var<storage, read> page_slots: array<u32>;
// Pages of units, each as it lies in a frame of the pool.
@group(0) @binding(7) var<storage, read> frames: array<u32>;
// A bit a slot: set where a ray has read it; then, as the last word, steps of all walks.
@group(0) @binding(8) var<storage, read_write> slots_used: array<atomic<u32>>;

// Outcomes: those of `GAnswer`, and that of a walk which was not ended.
const BLOCKED: u32 = 0u;
const NOTHING: u32 = 1u;
const MET: u32 = 2u;
const UNANSWERED: u32 = 3u;
// From this bit on an outcome holds the page that a ray wants, plus 1; 0 for none.
const WANT_SHIFT: u32 = 2u;

const KIND_SHADOW: u32 = 0u;
const KIND_GATHER: u32 = 1u;
const KIND_PHOTON: u32 = 3u;

const PAGE_MISSING: u32 = 0u;
const PAGE_NEVER: u32 = 1u;
const PAGE_SLOTS: u32 = 2u;

// No unit, no leaf of a unit.
const NONE: u32 = 0xffffffffu;
// Half words of the head of a frame.
const FRAME_HEAD_HALVES: u32 = 4u;

fn bit_of(mask: vec2<u32>, place: u32) -> bool {
    return (select(mask.x, mask.y, place >= 32u) >> (place & 31u) & 1u) == 1u;
}

// Bits that are set below a place.
fn rank_of(mask: vec2<u32>, place: u32) -> u32 {
    let below = (1u << (place & 31u)) - 1u;
    if place < 32u {
        return countOneBits(mask.x & below);
    }
    return countOneBits(mask.x) + countOneBits(mask.y & below);
}

// Half word `at` of the frame that begins at word `base`.
fn half_of(base: u32, at: u32) -> u32 {
    return frames[base + (at >> 1u)] >> (16u * (at & 1u)) & 0xffffu;
}

fn byte_of(base: u32, at: u32) -> u32 {
    return frames[base + (at >> 2u)] >> (8u * (at & 3u)) & 0xffu;
}

struct UnitsHead {
    units: u32,
    nodes: u32,
    leaves: u32,
    material_bytes: u32,
    is_linked: bool,
    // Half words before the links.
    links_at: u32,
}

fn units_head(base: u32) -> UnitsHead {
    let counts = frames[base];
    let rest = frames[base + 1u];
    let units = counts & 0xffffu;
    let unit_nodes = counts >> 16u;
    let links_at = FRAME_HEAD_HALVES + units + unit_nodes + 2u;
    return UnitsHead(units, unit_nodes, rest & 0xffffu, rest >> 16u & 0xffu, rest >> 24u != 0u, links_at);
}

// Normal in the lower half, material in the upper one, of a leaf of a unit.
fn unit_leaf_word(base: u32, leaf: u32) -> u32 {
    let head = units_head(base);
    let normals_at = head.links_at + select(0u, 2u * head.nodes, head.is_linked);
    let materials_at = normals_at + head.leaves;
    var material: u32;
    if head.material_bytes == 1u {
        material = byte_of(base, 2u * materials_at + leaf);
    } else {
        material = half_of(base, materials_at + leaf);
    }
    return half_of(base, normals_at + leaf) | material << 16u;
}

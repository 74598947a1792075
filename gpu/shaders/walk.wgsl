// Shared text 2 of 3: the walk from cell to cell: the twin of `render/src/voxel/traverse.rs` and `lower.rs`, which
// say why.

struct Entry {
    origin: vec3<f32>,
    direction: vec3<f32>,
    inverse: vec3<f32>,
    t_max: f32,
    flip: u32,
    axis: u32,
}

struct VoxelFound {
    outcome: u32,
    t: f32,
    axis: u32,
    node: u32,
    leaf: u32,
    // The leaf of a unit: first word of its frame, index in the page; NONE for an upper leaf.
    base: u32,
    unit_leaf: u32,
    // The page that finer voxels wait for, plus 1; 0 for none.
    want: u32,
}

// The leaf of a unit that a ray goes down to, or why there is none.
struct LeafBelow {
    // PAGE_MISSING, PAGE_NEVER, or PAGE_SLOTS where the unit is there; `is_set` says then whether the leaf is.
    state: u32,
    is_set: bool,
    bitmap: vec2<u32>,
    unit: u32,
    rank: u32,
    base: u32,
    leaf: u32,
}

const NO_BELOW: LeafBelow = LeafBelow(PAGE_NEVER, false, vec2<u32>(0u, 0u), NONE, 0u, NONE, NONE);
const EIGHTH: u32 = 0x330033u;
const FAR_AWAY: f32 = 3.4028234e38;
// MAX_DEPTH + 1, MAX_FINER + 1 of the store.
const PATH_LEVELS: u32 = 6u;
const OPEN_LEVELS: u32 = 3u;

// Empty cubes that the ray of this invocation has left; counted where that is asked for.
var<private> steps: u32 = 0u;

fn found_nothing() -> VoxelFound {
    return VoxelFound(NOTHING, 0.0, 0u, 0u, 0u, NONE, NONE, 0u);
}

fn kind_of(ray: GRay) -> u32 {
    return ray.bits >> 8u;
}

fn origin_of(ray: GRay) -> vec3<f32> {
    return vec3<f32>(ray.origin_x, ray.origin_y, ray.origin_z);
}

fn direction_of(ray: GRay) -> vec3<f32> {
    return vec3<f32>(ray.direction_x, ray.direction_y, ray.direction_z);
}

fn place_of(cell: vec3<u32>, shift: u32, flip: u32) -> u32 {
    return ((cell.x >> shift & 3u) | (cell.y >> shift & 3u) << 2u | (cell.z >> shift & 3u) << 4u) ^ flip;
}

// `Open::below` of the processor's walk: the child of a leaf in `place`.
fn look_below(bitmap: vec2<u32>, unit_word: u32, rank: u32, place: u32) -> LeafBelow {
    var below = NO_BELOW;
    if unit_word == NONE {
        return below;
    }
    let page = unit_word & ((1u << PAGE_BITS) - 1u);
    let state = page_slots[page];
    if state < PAGE_SLOTS {
        below.state = state;
        return below;
    }
    let slot = state - PAGE_SLOTS;
    if (atomicLoad(&slots_used[slot >> 5u]) >> (slot & 31u) & 1u) == 0u {
        atomicOr(&slots_used[slot >> 5u], 1u << (slot & 31u));
    }
    let base = slot * FRAME_WORDS;
    let head = units_head(base);
    let unit = unit_word >> PAGE_BITS;
    if unit >= head.units {
        return below;
    }
    let first_node = half_of(base, FRAME_HEAD_HALVES + unit);
    if rank >= half_of(base, FRAME_HEAD_HALVES + unit + 1u) - first_node {
        return below;
    }
    let node = first_node + rank;
    let first_at = FRAME_HEAD_HALVES + head.units + 1u + node;
    let first = half_of(base, first_at);
    let count = half_of(base, first_at + 1u) - first;
    if countOneBits(bitmap.x) + countOneBits(bitmap.y) != count {
        return below;
    }
    below.state = PAGE_SLOTS;
    below.is_set = bit_of(bitmap, place);
    if !below.is_set {
        return below;
    }
    below.base = base;
    below.leaf = first + rank_of(bitmap, place);
    below.rank = below.leaf - first;
    let bitmap_at = base + FRAME_WORDS - 2u * head.leaves + 2u * below.leaf;
    below.bitmap = vec2<u32>(frames[bitmap_at], frames[bitmap_at + 1u]);
    if head.is_linked {
        let link_at = head.links_at + 2u * node;
        below.unit = half_of(base, link_at) | half_of(base, link_at + 1u) << 16u;
    }
    return below;
}

// Walks through the leaves that are `finer` levels below the upper ones.
fn walk(ray: Entry, finer: u32) -> VoxelFound {
    let depth = params.depth;
    let finest = depth + finer;
    let last = (1u << (2u * (finest + 1u))) - 1u;
    var cell = min(vec3<u32>(max(ray.origin, vec3<f32>(0.0))), vec3<u32>(last));
    var found = found_nothing();
    found.axis = ray.axis;
    // Node of each level over the cell; at `depth` the upper leaf. From there on, leaves that the ray is in.
    var path: array<u32, PATH_LEVELS>;
    var open_bitmap: array<vec2<u32>, OPEN_LEVELS>;
    var open_unit: array<u32, OPEN_LEVELS>;
    var open_rank: array<u32, OPEN_LEVELS>;
    var open_base: array<u32, OPEN_LEVELS>;
    var open_leaf: array<u32, OPEN_LEVELS>;
    path[0] = 0u;
    var level = 0u;
    // Of the node or leaf at `level`: read when the walk comes there, not at each step through it.
    var mask = vec2<u32>(nodes[0], nodes[1]);
    var first_child = nodes[2];
    for (var step = 0u; step < params.steps_max; step++) {
        var shift: u32;
        // Down to a child that is missing, or to a voxel below which there is none.
        loop {
            shift = 2u * (finest - level);
            let place = place_of(cell, shift, ray.flip);
            if level < depth {
                if !bit_of(mask, place) {
                    break;
                }
                let rank = rank_of(mask, place);
                let child = first_child + rank;
                level += 1u;
                path[level] = child;
                if level == depth {
                    mask = vec2<u32>(bitmaps[2u * child], bitmaps[2u * child + 1u]);
                    open_bitmap[0] = mask;
                    open_rank[0] = rank;
                    open_base[0] = NONE;
                    open_leaf[0] = NONE;
                    open_unit[0] = NONE;
                    if HAS_UNITS && finer > 0u {
                        let number = path[depth - 1u] - params.first_last;
                        open_unit[0] = payload[params.last_nodes_at + 3u * number + 2u];
                    }
                } else {
                    mask = vec2<u32>(nodes[3u * child], nodes[3u * child + 1u]);
                    first_child = nodes[3u * child + 2u];
                }
                continue;
            }
            // Without units a constant, which spares the walk all arrays of open leaves.
            let open = select(0u, level - depth, HAS_UNITS);
            if !bit_of(mask, place) && params.is_whole == 0u {
                break;
            }
            var below = NO_BELOW;
            if HAS_UNITS && level < finest {
                below = look_below(mask, open_unit[open], open_rank[open], place);
            }
            if below.state < PAGE_SLOTS {
                found.outcome = MET;
                found.node = path[depth - 1u];
                found.leaf = path[depth];
                found.base = open_base[open];
                found.unit_leaf = open_leaf[open];
                if below.state == PAGE_MISSING {
                    found.want = (open_unit[open] & ((1u << PAGE_BITS) - 1u)) + 1u;
                }
                return found;
            }
            if !below.is_set {
                break;
            }
            level += 1u;
            mask = below.bitmap;
            open_bitmap[open + 1u] = mask;
            open_unit[open + 1u] = below.unit;
            open_rank[open + 1u] = below.rank;
            open_base[open + 1u] = below.base;
            open_leaf[open + 1u] = below.leaf;
        }
        if COUNTS_STEPS {
            steps += 1u;
        }
        // Leaves the empty cube around the cell, or the empty eighth of the node around that.
        let corner = place_of(cell, shift, ray.flip) & 42u;
        let eighth = select(mask.x, mask.y, corner >= 32u) & EIGHTH << (corner & 31u);
        let within = (1u << (shift + select(0u, 1u, eighth == 0u))) - 1u;
        let end = (cell | vec3<u32>(within)) + vec3<u32>(1u);
        let t_axis = (vec3<f32>(end) - ray.origin) * ray.inverse;
        var axis = select(0u, 1u, t_axis.y < t_axis.x);
        var t_exit = min(t_axis.x, t_axis.y);
        if t_axis.z < t_exit {
            axis = 2u;
            t_exit = t_axis.z;
        }
        found.axis = axis;
        found.t = max(found.t, t_exit);
        if found.t > ray.t_max {
            return found_nothing();
        }
        let at = vec3<u32>(vec3<i32>(ray.origin + found.t * ray.direction));
        var next = min(max(at, cell), end - vec3<u32>(1u));
        next = select(next, end, vec3<bool>(axis == 0u, axis == 1u, axis == 2u));
        if max(max(next.x, next.y), next.z) > last {
            return found_nothing();
        }
        let apart = (next.x ^ cell.x) | (next.y ^ cell.y) | (next.z ^ cell.z);
        // Up to the node that holds both.
        let both = finest - min((31u - countLeadingZeros(apart)) / 2u, finest);
        cell = next;
        if both < level {
            level = both;
            if level < depth {
                let at = 3u * path[level];
                mask = vec2<u32>(nodes[at], nodes[at + 1u]);
                first_child = nodes[at + 2u];
            } else {
                mask = open_bitmap[select(0u, level - depth, HAS_UNITS)];
            }
        }
    }
    found = found_nothing();
    found.outcome = UNANSWERED;
    return found;
}

fn enter(ray: GRay, origin: vec3<f32>, t_max: f32, axis: u32) -> Entry {
    let direction = direction_of(ray);
    return Entry(origin, direction, vec3<f32>(1.0) / direction, t_max, ray.bits & 0x3fu, axis);
}

// Distance at which the cone of a ray is as wide as `side`.
fn reach_of(ray: GRay, side: f32) -> f32 {
    let left = side - ray.width;
    if left <= 0.0 {
        return 0.0;
    }
    if ray.spread > 0.0 {
        return left / ray.spread;
    }
    return FAR_AWAY;
}

// What a ray finds: through the leaves of each level that its cone lets it read, finest first.
fn find(ray: GRay) -> VoxelFound {
    if ray.t_max < 0.0 {
        return found_nothing();
    }
    let axis = ray.bits >> 6u & 3u;
    let origin = origin_of(ray);
    let asks_units = kind_of(ray) == KIND_SHADOW || kind_of(ray) == KIND_GATHER;
    if !HAS_UNITS || params.finer == 0u || !asks_units {
        return walk(enter(ray, origin, ray.t_max, axis), 0u);
    }
    let direction = direction_of(ray);
    var longest = select(0u, 1u, direction.y > direction.x);
    longest = select(longest, 2u, direction.z > max(direction.x, direction.y));
    var start = 0.0;
    var found = found_nothing();
    for (var coarser = 0u; coarser <= params.finer; coarser++) {
        let side = f32(1u << (2u * coarser));
        let is_upper = coarser == params.finer;
        var end = FAR_AWAY;
        if !is_upper {
            end = reach_of(ray, 4.0 * side);
        }
        if start >= end || start > ray.t_max {
            continue;
        }
        let scale = 1.0 / side;
        let part_origin = scale * (origin + start * direction);
        let part_t_max = scale * (min(end, ray.t_max) - start);
        if part_t_max >= 0.0 {
            let part = enter(ray, part_origin, part_t_max, select(axis, longest, start > 0.0));
            found = walk(part, params.finer - coarser);
            if found.outcome != NOTHING {
                found.t = start + side * found.t;
                return found;
            }
        }
        start = end;
    }
    return found;
}

// Adds the steps of this invocation to those of the batch.
fn tell_steps() {
    if COUNTS_STEPS {
        atomicAdd(&slots_used[arrayLength(&slots_used) - 1u], steps);
    }
}

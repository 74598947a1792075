// Shared text 3 of 3: what a leaf says of the surface in it: the twin of `GRay::facing` and `VoxelScene::side`.

// `FLAT`, `ALONG_LEAST` of `render/src/voxel/g_ray.rs`; `LENGTH_MOST` of `store/src/octree/payload.rs`.
const FLAT: f32 = 0.85;
const ALONG_LEAST: f32 = 1e-9;
const LENGTH_MOST: f32 = 15.0;

fn folded(v: i32, fold: i32) -> i32 {
    return select(v - fold, v + fold, v < 0);
}

// The direction of a leaf's normal, of some length, in integers.
fn octahedral(word: u32) -> vec3<i32> {
    let most = (1u << OCTAHEDRAL_BITS) - 1u;
    let middle = i32(most) - 1;
    let x = 2 * i32(word & most) - middle;
    let y = 2 * i32(word >> OCTAHEDRAL_BITS & most) - middle;
    let z = middle - abs(x) - abs(y);
    let fold = max(-z, 0);
    return vec3<i32>(folded(x, fold), folded(y, fold), z);
}

fn flatness_of(word: u32) -> f32 {
    return f32(word >> (2u * OCTAHEDRAL_BITS) & 15u) / LENGTH_MOST;
}

fn sum_of_products(a: vec3<f32>, b: vec3<f32>) -> f32 {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

// Unit normal; zero where none is known.
fn normal_of(word: u32) -> vec3<f32> {
    if (word >> (2u * OCTAHEDRAL_BITS) & 15u) == 0u {
        return vec3<f32>(0.0);
    }
    let n = vec3<f32>(octahedral(word));
    return n / sqrt(sum_of_products(n, n));
}

// Which of the six facets of its node a leaf belongs to.
fn facet_of(word: u32) -> u32 {
    let n = octahedral(word);
    let size = abs(n);
    var axis = 2u;
    var along = n.z;
    if size.x >= size.y && size.x >= size.z {
        axis = 0u;
        along = n.x;
    } else if size.y >= size.z {
        axis = 1u;
        along = n.y;
    }
    return 2u * axis + select(0u, 1u, along < 0);
}

// Unit normal of the surface in a leaf that is entered across `axis`, on the side that the ray comes from.
fn facing(ray: GRay, word: u32, axis: u32) -> vec3<f32> {
    let flip = vec3<u32>(ray.bits, ray.bits >> 2u, ray.bits >> 4u) & vec3<u32>(1u);
    let way = select(direction_of(ray), -direction_of(ray), flip == vec3<u32>(1u));
    let normal = normal_of(word);
    let along = select(select(way.x, way.y, axis == 1u), way.z, axis == 2u);
    var sign_of_face = 0.0;
    if abs(along) > ALONG_LEAST {
        sign_of_face = select(1.0, -1.0, along > 0.0);
    }
    let face = select(vec3<f32>(0.0), vec3<f32>(sign_of_face), vec3<bool>(axis == 0u, axis == 1u, axis == 2u));
    let ahead = -sum_of_products(way, normal);
    let across = sum_of_products(face, normal);
    if flatness_of(word) < FLAT && ahead * across < 0.0 {
        return face;
    }
    let side = select(ahead, across, ahead == 0.0);
    if side == 0.0 {
        return -way;
    }
    return select(-normal, normal, side > 0.0);
}

// The side of a facet that the surface in an upper leaf shows to where `normal` looks.
fn side_of(found: VoxelFound, normal: vec3<f32>) -> u32 {
    let word = payload[found.leaf];
    let at = params.last_nodes_at + 3u * (found.node - params.first_last);
    let below = (1u << facet_of(word)) - 1u;
    let facet = payload[at] + countOneBits(payload[at + 1u] & below);
    return 2u * facet + select(0u, 1u, sum_of_products(normal, normal_of(word)) < 0.0);
}

// Entry point: rays that learn which surface they meet: gather rays, C-rays behind the cut, photons.

@compute @workgroup_size(WORKGROUP_RAYS)
fn surface_rays(@builtin(global_invocation_id) id: vec3<u32>) {
    let index = params.shadow_count + id.x;
    if index >= params.ray_count {
        return;
    }
    let ray = rays[index];
    let found = find(ray);
    tell_steps();
    let at = params.shadow_count + 8u * id.x;
    answers[at] = found.outcome | found.want << WANT_SHIFT;
    if found.outcome != MET {
        for (var word = 1u; word < 8u; word++) {
            answers[at + word] = 0u;
        }
        return;
    }
    var leaf_word: u32;
    if found.base == NONE {
        leaf_word = payload[found.leaf];
    } else {
        leaf_word = unit_leaf_word(found.base, found.unit_leaf);
    }
    let normal = facing(ray, leaf_word, found.axis);
    let asks_light = kind_of(ray) == KIND_GATHER || kind_of(ray) == KIND_PHOTON;
    answers[at + 1u] = bitcast<u32>(found.t);
    answers[at + 2u] = 0u;
    if asks_light {
        answers[at + 2u] = side_of(found, normal);
    }
    answers[at + 3u] = leaf_word >> 16u;
    answers[at + 4u] = found.axis;
    answers[at + 5u] = bitcast<u32>(normal.x);
    answers[at + 6u] = bitcast<u32>(normal.y);
    answers[at + 7u] = bitcast<u32>(normal.z);
}

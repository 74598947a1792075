// Entry point: shadow rays, which learn whether they meet anything.

@compute @workgroup_size(64)
fn shadow_rays(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.shadow_count {
        return;
    }
    let found = find(rays[id.x]);
    answers[id.x] = found.outcome | found.want << WANT_SHIFT;
}

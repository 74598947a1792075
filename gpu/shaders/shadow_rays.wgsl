// Entry point: shadow rays, which learn whether they meet anything.

@compute @workgroup_size(WORKGROUP_RAYS)
fn shadow_rays(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.shadow_count {
        return;
    }
    let found = find(rays[id.x]);
    tell_steps();
    answers[id.x] = found.outcome | found.want << WANT_SHIFT;
}

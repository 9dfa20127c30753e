// The first pixel of a block of `stride` x `stride` that belongs to a head; the last one looked at if
// none does.
vec4 first_of_block(sampler2D visible_xyz, ivec2 block, int stride, float slot, out ivec2 pixel) {
    ivec2 corner = block * stride;
    pixel = corner;
    vec4 surface = texelFetch(visible_xyz, pixel, 0);
    for (int index = 1; index < stride * stride && !is_owner(surface.w, slot); ++index) {
        pixel = min(corner + ivec2(index & 1, index >> 1), textureSize(visible_xyz, 0) - 1);
        surface = texelFetch(visible_xyz, pixel, 0);
    }
    return surface;
}

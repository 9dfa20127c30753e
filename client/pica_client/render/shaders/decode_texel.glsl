// One texel of an image in four phases, whose tile begins at a place.
vec4 read_texel(ivec2 texel, ivec2 tile) {
    ivec2 place = tile + (texel >> 1);
    if ((texel.y & 1) == 0) {
        return (texel.x & 1) == 0 ? texelFetch(phase0, place, 0) : texelFetch(phase1, place, 0);
    }
    return (texel.x & 1) == 0 ? texelFetch(phase2, place, 0) : texelFetch(phase3, place, 0);
}

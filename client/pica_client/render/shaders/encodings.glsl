// What the pixel decoder is told of a place on the surface, by one of four encodings. `reach` is log2
// of how far the pixel reaches along u and v, in parts of the texture: what lies within is averaged.

uniform sampler2D u_encoding; // m_u(u) and m_v(v), tables of codes
uniform sampler2D v_encoding;
uniform sampler2D uv_encoding; // m_uv(u, v), a map of codes

// One level finer than what a pixel covers: at heads 64 to 256 pixels high half to a third less error
// and flicker than with the level itself, and than with none (MSE 9, 17 and 12; a moving head's 7, 7
// and 15).
const float UV_LOD_BIAS = -1.0;
const float TURN = 6.283185307179586;

// A table of AXIS_SIZE entries and its levels, each the mean of twice as many entries as the one
// before, folded into rows of AXIS_ROW texels: 10,000 entries are more than the narrowest texture that
// an implementation must offer. A texel holds an entry and the way to the next one, so a lookup
// between two of them reads one. The level is the one that is not wider than the reach; between levels
// nothing is mixed, for the width hardly shows.
vec2 fetch_mean(sampler2D table, float t, float reach) {
    int level = clamp(int(reach + LOG2_AXIS_SIZE), 0, AXIS_LEVELS - 1);
    float count = float(AXIS_SIZE) * intBitsToFloat((127 - level) << 23); // times 2^-level
    float place = clamp(t * count - 0.5, 0.0, ceil(count) - 1.0);
    int entry = int(place);
    int index = 2 * AXIS_STRIDE - (2 * AXIS_STRIDE >> level) + entry;
    vec4 found = texelFetch(table, ivec2(index & (AXIS_ROW - 1), index / AXIS_ROW), 0);
    return found.xy + (place - float(entry)) * found.zw;
}

vec4 axis_codes(vec2 uv, vec2 reach) {
#ifndef FILTERED
    reach = vec2(-LOG2_AXIS_SIZE);
#endif
    return vec4(fetch_mean(u_encoding, uv.x, reach.x), fetch_mean(v_encoding, uv.y, reach.y));
}

vec4 joint_code(vec2 uv, vec2 reach) {
#ifdef FILTERED
    float lod = max(reach.x, reach.y) + LOG2_UV_SIZE + UV_LOD_BIAS;
#else
    float lod = 0.0;
#endif
    return textureLod(uv_encoding, uv, lod);
}

// sin u, sin v, cos u, cos v of octave k. The mean of a wave over w of its periods is sin(pi w) / (pi w)
// of it; beyond one period nothing is left. The polynomial is off by less than 0.003.
vec4 octave_code(vec2 uv, vec2 reach, float k) {
    vec2 angle = fract(uv * exp2(k)) * TURN;
    vec4 code = vec4(sin(angle), cos(angle));
#ifdef FILTERED
    vec2 w = min(exp2(reach + k), 1.0);
    vec2 q = w * w;
    vec2 mean = (1.0 - q) * (1.0 - q * (0.6449 - 0.165 * q));
    code *= vec4(mean, mean);
#endif
    return code;
}

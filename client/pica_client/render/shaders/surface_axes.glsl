// m_u(u) in xy and m_v(v) in zw, two tables of codes.

uniform sampler2D u_encoding;
uniform sampler2D v_encoding;

#include "axis_table.glsl"

// `reach` is log2 of how far the pixel reaches along u and v: what lies within it is averaged.
vec4 axis_codes(vec2 uv, vec2 reach) {
#ifndef FILTERED
    reach = vec2(-LOG2_AXIS_SIZE);
#endif
    return vec4(fetch_mean(u_encoding, uv.x, reach.x), fetch_mean(v_encoding, uv.y, reach.y));
}

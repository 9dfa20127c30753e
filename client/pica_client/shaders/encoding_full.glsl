// The paper's input vector p = [expression 4, encoded xyz 4, m_uv 4, m_u 2 and m_v 2].

uniform sampler2D uv_encoding;
uniform sampler2D u_encoding;
uniform sampler2D v_encoding;

// One level finer than what a pixel covers: at heads 64 to 256 pixels high half to a third less error
// and flicker than with the level itself, and than with none (MSE 9, 17 and 12; a moving head's 7, 7
// and 15).
const float UV_LOD_BIAS = -1.0;

// `reach` is log2 of how far the pixel reaches along u and v: what lies within it is averaged.
vec3 colour_pixel(vec4 expression, vec3 xyz_m, vec2 uv, vec2 reach) {
#ifdef FILTERED
    float lod = max(reach.x, reach.y) + LOG2_UV_SIZE + UV_LOD_BIAS;
#else
    reach = vec2(-LOG2_AXIS_SIZE);
    float lod = 0.0;
#endif
    vec2 m_u = fetch_mean(u_encoding, uv.x, reach.x);
    vec2 m_v = fetch_mean(v_encoding, uv.y, reach.y);
    vec4 m_uv = textureLod(uv_encoding, uv, lod);
    return decode_pixel(expression, encode_xyz(xyz_m), m_uv, vec4(m_u, m_v));
}

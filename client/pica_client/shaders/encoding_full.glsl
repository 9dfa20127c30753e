// The paper's input vector p = [expression 4, encoded xyz 4, m_uv 4, m_u 2 and m_v 2].

uniform sampler2D uv_encoding;
uniform sampler2D u_encoding;
uniform sampler2D v_encoding;

vec3 colour_pixel(vec4 expression, vec3 xyz_m, vec2 uv) {
    vec2 m_u = fetch_linear(u_encoding, AXIS_SIZE, uv.x);
    vec2 m_v = fetch_linear(v_encoding, AXIS_SIZE, uv.y);
    return decode_pixel(expression, encode_xyz(xyz_m), texture(uv_encoding, uv), vec4(m_u, m_v));
}

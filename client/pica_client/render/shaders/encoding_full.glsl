// The paper's input vector p = [expression 4, encoded xyz 4, m_uv 4, m_u 2 and m_v 2].

#include "surface_joint.glsl"
#include "surface_axes.glsl"

vec3 colour_pixel(vec4 expression, vec3 xyz_m, vec2 uv, vec2 reach) {
    return decode_pixel(expression, encode_xyz(xyz_m), joint_code(uv, reach), axis_codes(uv, reach));
}

// p = [expression 4, encoded xyz 4, m_uv 4].

#include "surface_joint.glsl"

vec3 colour_pixel(vec4 expression, vec3 xyz_m, vec2 uv, vec2 reach) {
    return decode_pixel(expression, encode_xyz(xyz_m), joint_code(uv, reach));
}

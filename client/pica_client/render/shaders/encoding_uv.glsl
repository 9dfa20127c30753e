// p = [expression 4, encoded xyz 4, u and v in [-1, 1]].

vec3 colour_pixel(vec4 expression, vec3 xyz_m, vec2 uv, vec2 reach) {
    return decode_pixel(expression, encode_xyz(xyz_m), vec4(2.0 * uv - 1.0, 0.0, 0.0));
}

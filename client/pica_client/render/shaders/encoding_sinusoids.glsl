// p = [expression 4, encoded xyz 4, ten octaves of sines and cosines of u and v].

#include "surface_sinusoids.glsl"

vec3 colour_pixel(vec4 expression, vec3 xyz_m, vec2 uv, vec2 reach) {
    return decode_pixel(
        expression, encode_xyz(xyz_m),
        octave_code(uv, reach, 0.0), octave_code(uv, reach, 1.0),
        octave_code(uv, reach, 2.0), octave_code(uv, reach, 3.0),
        octave_code(uv, reach, 4.0), octave_code(uv, reach, 5.0),
        octave_code(uv, reach, 6.0), octave_code(uv, reach, 7.0),
        octave_code(uv, reach, 8.0), octave_code(uv, reach, 9.0));
}

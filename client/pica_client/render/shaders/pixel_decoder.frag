// Second pass: colour the pixels that the surface pass found. Ma et al., "Pixel Codec Avatars" (CVPR 2021),
// section 3 "Pixel Decoder"; the numpy twin is pica_core/reference.py.

uniform sampler2D visible_xyz; // what surface.frag wrote
uniform sampler2D visible_uv;
uniform sampler2D expression_map;
uniform bool is_change; // whether the expression map is what is added to the still one
uniform sampler2D still_map;

layout(location = 0) out vec4 colour;

#include "pixels.glsl"
#include "encodings.glsl"
#include "siren.glsl" // generated: vec4 encode_xyz(vec3 xyz_m), vec3 decode_pixel(vec4 p0, vec4 p1, vec4 p2, ...)

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 surface = texelFetch(visible_xyz, pixel, 0);
    vec2 uv = texelFetch(visible_uv, pixel, 0).xy;
    vec4 expression = textureLod(expression_map, uv, 0.0);
    if (is_change) {
        expression += textureLod(still_map, uv, 0.0);
    }
    vec2 reach = unpack_footprint(surface.w);
    vec3 rgb = decode_pixel(expression, encode_xyz(surface.xyz) SURFACE_CODES);
    colour = presence(surface.xyz) * vec4(clamp(rgb, 0.0, 1.0), 1.0);
}

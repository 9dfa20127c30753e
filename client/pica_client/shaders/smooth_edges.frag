// Anti-aliasing after shading: where neighbouring pixels differ in brightness, blur along the edge.
// Everything else is discarded and keeps what is already in the target. It costs a few lookups per
// pixel, whereas four samples per pixel would cost the pixel decoder four times.

uniform sampler2D image;
uniform vec2 texel; // size of a pixel in texture coordinates

layout(location = 0) out vec4 colour;

const float CONTRAST = 0.06; // smallest difference that shows as a stair
const float REACH = 6.0; // pixels along the edge, at most

#include "brightness.glsl"

float brightness_at(ivec2 pixel) {
    return texelFetch(image, clamp(pixel, ivec2(0), textureSize(image, 0) - 1), 0).a;
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float upper_left = brightness_at(pixel + ivec2(-1, 1));
    float upper_right = brightness_at(pixel + ivec2(1, 1));
    float lower_left = brightness_at(pixel + ivec2(-1, -1));
    float lower_right = brightness_at(pixel + ivec2(1, -1));
    float darkest = min(min(upper_left, upper_right), min(lower_left, lower_right));
    float brightest = max(max(upper_left, upper_right), max(lower_left, lower_right));
    if (brightest - darkest < CONTRAST) {
        discard;
    }
    // The edge runs across the gradient; near an axis it runs far, so the blur may reach further.
    vec2 along = vec2(lower_left + lower_right - upper_left - upper_right,
                      upper_left + lower_left - upper_right - lower_right);
    float steep = min(abs(along.x), abs(along.y)) + 0.02 * (brightest + darkest);
    along = clamp(along / steep, -REACH, REACH) * texel;
    vec2 here = gl_FragCoord.xy * texel;
    vec3 near_pair = 0.5 * (texture(image, here - along / 6.0).rgb + texture(image, here + along / 6.0).rgb);
    vec3 far_pair = 0.5 * (texture(image, here - along / 2.0).rgb + texture(image, here + along / 2.0).rgb);
    vec3 wide = 0.5 * (near_pair + far_pair);
    float found = brightness(wide);
    // Outside the range of the neighbours the long blur has crossed another edge.
    bool crossed = found < darkest || found > brightest;
    colour = vec4(crossed ? near_pair : wide, 1.0);
}

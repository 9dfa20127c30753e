// Anti-aliasing after shading: along the silhouette of a head, blur along the edge, colours and what is
// there of them alike. Everything else is discarded and keeps what is already in the target; most of it
// never gets here (near_edges.frag).
// It costs a few lookups per pixel, whereas four samples per pixel would cost the pixel decoder four
// times. Within a head nothing is blurred: that doubled the error there (MSE 9 and 16 against many
// samples a pixel), for hair and lashes are edges too.

uniform sampler2D layer;
uniform sampler2D layer_depth; // 1 is nothing

layout(location = 0) out vec4 colour;

const float REACH = 3.0; // pixels along the edge, at most

#include "covered.glsl"

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float upper_left = covered(pixel + ivec2(-1, 1));
    float upper_right = covered(pixel + ivec2(1, 1));
    float lower_left = covered(pixel + ivec2(-1, -1));
    float lower_right = covered(pixel + ivec2(1, -1));
    if (upper_left == upper_right && lower_left == lower_right && upper_left == lower_left) {
        discard;
    }
    // The edge runs across the gradient; near an axis it runs far, so the blur may reach further.
    vec2 along = vec2(lower_left + lower_right - upper_left - upper_right,
                      upper_left + lower_left - upper_right - lower_right);
    vec2 texel = 1.0 / vec2(textureSize(layer, 0));
    along = clamp(along / (min(abs(along.x), abs(along.y)) + 0.02), -REACH, REACH) * texel;
    vec2 here = gl_FragCoord.xy * texel;
    colour = 0.25 * (textureLod(layer, here - along / 2.0, 0.0) + textureLod(layer, here - along / 6.0, 0.0)
                     + textureLod(layer, here + along / 6.0, 0.0) + textureLod(layer, here + along / 2.0, 0.0));
}

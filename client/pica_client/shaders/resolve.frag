// Fills in what a coarse image left out: between coarse pixels of one head by their mean, at its edges
// by the pixel of the block. Silhouettes stay as sharp as the surface pass drew them.

uniform sampler2D visible_xyz;
uniform sampler2D coarse_image; // alpha says whose a pixel is
uniform float slot;
uniform float mark; // whose the pixel is, for the passes after this one

layout(location = 0) out vec4 colour;

#include "owner.glsl"
#include "mark.glsl"

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    if (!is_owner(texelFetch(visible_xyz, pixel, 0).w, slot)) {
        discard;
    }
    // A coarse pixel lies at the first pixel of its block: there this reads it alone, elsewhere it
    // mixes two or four.
    vec2 place = (0.5 * vec2(pixel) + 0.5) / vec2(textureSize(coarse_image, 0));
    vec4 mixed = textureLod(coarse_image, place, 0.0);
    bool is_ours = abs(mixed.a - mark_of(slot)) < 0.0015;
    vec3 own = texelFetch(coarse_image, pixel / 2, 0).rgb;
    colour = vec4(is_ours ? mixed.rgb : own, mark_of(mark));
}

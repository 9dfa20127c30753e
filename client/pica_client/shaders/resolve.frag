// Fills in what a coarse image left out: each pixel of a head takes the mean of those of its coarse
// neighbours that are of the same head. Silhouettes stay as sharp as the surface pass drew them.

uniform sampler2D visible_xyz;
uniform sampler2D coarse_image;
uniform float slot;

layout(location = 0) out vec4 colour;

#include "owner.glsl"
#include "mark.glsl"

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    if (!is_owner(texelFetch(visible_xyz, pixel, 0).w, slot)) {
        discard;
    }
    ivec2 low = pixel / 2;
    ivec2 high = min(low + (pixel & 1), textureSize(coarse_image, 0) - 1);
    vec4 sum = vec4(0.0);
    for (int index = 0; index < 4; ++index) {
        ivec2 place = ivec2((index & 1) == 0 ? low.x : high.x, index < 2 ? low.y : high.y);
        vec4 found = texelFetch(coarse_image, place, 0);
        bool is_same = abs(found.a - mark_of(slot)) < 0.001;
        sum += is_same ? vec4(found.rgb, 1.0) : vec4(0.0);
    }
    // The pixel's own block has always one of its head: the sum is never empty.
    colour = vec4(sum.rgb / max(sum.a, 1.0), mark_of(slot));
}

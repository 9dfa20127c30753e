// Which coarse pixels have a pixel of a head in their block: the others are dropped, and these keep
// the depth of the rectangle. A depth test then keeps the pixel decoder to them.

uniform sampler2D visible_xyz;
uniform float slot;

#include "owner.glsl"
#include "block_owner.glsl"

void main() {
    ivec2 pixel;
    vec4 surface = first_of_block(visible_xyz, ivec2(gl_FragCoord.xy), 2, slot, pixel);
    if (!is_owner(surface.w, slot)) {
        discard;
    }
}

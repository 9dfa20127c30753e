// A copy of a layer, and beside it which pixels may be near a silhouette: depth 1, others 0. A pass of
// its own because programs are not left early: what is found here in one lookup, a depth test then
// skips, block by block.
//
// Pixels run in blocks of 2x2: each looks at its corner of the ring around the block, and their
// differences tell the block that no edge is near.

in vec2 place;

uniform sampler2D layer;
uniform sampler2D layer_depth; // 1 is nothing

layout(location = 0) out vec4 colour;

#include "covered.glsl"

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float corner = covered(pixel + 2 * (pixel & 1) - 1);
    gl_FragDepth = dFdx(corner) == 0.0 && dFdy(corner) == 0.0 ? 0.0 : 1.0;
    colour = textureLod(layer, place, 0.0);
}

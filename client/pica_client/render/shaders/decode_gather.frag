// One head's expression map, out of the four phases of all heads' maps.

uniform int head;
uniform int tile; // rows of a head in each phase

layout(location = 0) out vec4 value;

#include "decode_phases.glsl"
#include "decode_texel.glsl"

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    value = read_texel(texel, ivec2(0, tile * head));
}

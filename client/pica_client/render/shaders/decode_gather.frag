// The expression map of a head, out of the four phases of all heads' maps.

layout(location = 0) out vec4 value;

uniform int head; // which of the batch

#include "decode.glsl"

void main() {
    int tile_rows = textureSize(phase0, 0).x; // as many as columns
    value = read_texel(ivec2(gl_FragCoord.xy), ivec2(0, tile_rows * head));
}

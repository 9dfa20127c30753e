// The full expression map of a head: the last 1x1 convolution, and the pixel shuffle after it.

layout(location = 0) out vec4 value;

uniform int head; // which of the batch

#include "decode.glsl"

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    int avatar = avatar_of(head);
    int phase = 2 * (texel.y & 1) + (texel.x & 1);
    value = number(BIAS + phase, avatar);
    for (int from = 0; from < IN_VECTORS; ++from) {
        mat4 weights = block(WEIGHTS + 16 * from + 4 * phase, avatar);
        value += weights * read_texel(texel >> 1, SIZE / 2 * ivec2(from, head));
    }
}

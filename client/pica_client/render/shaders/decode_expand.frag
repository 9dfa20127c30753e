// A 1x1 convolution of all heads, and the pixel shuffle after it: each texel becomes a block of
// 2 x 2, with a LeakyReLU.

layout(location = 0) out vec4 value0;
layout(location = 1) out vec4 value1;
layout(location = 2) out vec4 value2;
layout(location = 3) out vec4 value3;

#include "decode.glsl"

void main() {
    ivec2 place = ivec2(gl_FragCoord.xy);
    int group = place.x / SIZE;
    int head = place.y / SIZE;
    ivec2 texel = place - SIZE * ivec2(group, head);
    int avatar = avatar_of(head);
    vec4 sum0 = number(BIAS + 4 * group, avatar);
    vec4 sum1 = number(BIAS + 4 * group + 1, avatar);
    vec4 sum2 = number(BIAS + 4 * group + 2, avatar);
    vec4 sum3 = number(BIAS + 4 * group + 3, avatar);
    int next = WEIGHTS + 16 * IN_VECTORS * group;
    for (int from = 0; from < IN_VECTORS; ++from) {
        vec4 value = read_texel(texel, SIZE / 2 * ivec2(from, head));
        sum0 += block(next, avatar) * value;
        sum1 += block(next + 4, avatar) * value;
        sum2 += block(next + 8, avatar) * value;
        sum3 += block(next + 12, avatar) * value;
        next += 16;
    }
    value0 = leaky(sum0);
    value1 = leaky(sum1);
    value2 = leaky(sum2);
    value3 = leaky(sum3);
}

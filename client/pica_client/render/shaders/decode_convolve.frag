// A 3x3 convolution of all heads, with a bias for each texel and a LeakyReLU: four channels of a
// block of 2 x 2 texels, so that each number is read once for four.

layout(location = 0) out vec4 value0;
layout(location = 1) out vec4 value1;
layout(location = 2) out vec4 value2;
layout(location = 3) out vec4 value3;

#include "decode.glsl"

#define BLOCKS (SIZE / 2)

#ifdef FIRST
// What the decoder begins with: the latent, and the view direction everywhere.
vec4 read(int odd, ivec2 at, int group, int head) {
    if (group == 1) {
        return vec4(texelFetch(heads, ivec2(VIEW, head), 0).xyz, 0.0);
    }
    ivec2 texel = 2 * at + ivec2(odd & 1, odd >> 1);
    return texelFetch(heads, ivec2(SIZE * texel.y + texel.x, head), 0);
}
#else
vec4 read(int odd, ivec2 at, int group, int head) {
    return read_phase(odd, at + BLOCKS * ivec2(group, head));
}
#endif

// Beyond the border there are zeros, whatever lies beside a head's tile.
vec4 read_or_zero(int odd, ivec2 at, int group, int head) {
    bool is_inside = all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, ivec2(BLOCKS)));
    return is_inside ? read(odd, at, group, head) : vec4(0.0);
}

void main() {
    ivec2 place = ivec2(gl_FragCoord.xy);
    int group = place.x / BLOCKS;
    int head = place.y / BLOCKS;
    ivec2 at = place - BLOCKS * ivec2(group, head);
    int avatar = avatar_of(head);
    int first = BIAS + (group * SIZE + 2 * at.y) * SIZE + 2 * at.x;
    vec4 sum0 = number(first, avatar);
    vec4 sum1 = number(first + 1, avatar);
    vec4 sum2 = number(first + SIZE, avatar);
    vec4 sum3 = number(first + SIZE + 1, avatar);
    int next = WEIGHTS + 36 * IN_VECTORS * group;
#ifdef LOCAL
    int own = LOCAL + 4 * IN_VECTORS * ((group * BLOCKS + at.y) * BLOCKS + at.x);
#endif
    for (int from = 0; from < IN_VECTORS; ++from) {
        // Two rows of four texels at a time, moving down over the block and what surrounds it.
        vec4 a0 = read_or_zero(3, at + ivec2(-1, -1), from, head);
        vec4 a1 = read_or_zero(2, at + ivec2(0, -1), from, head);
        vec4 a2 = read_or_zero(3, at + ivec2(0, -1), from, head);
        vec4 a3 = read_or_zero(2, at + ivec2(1, -1), from, head);
        for (int row = 0; row < 3; ++row) {
            int odd = row == 1 ? 2 : 0;
            ivec2 down = at + ivec2(0, row >> 1);
            vec4 b0 = read_or_zero(odd + 1, down + ivec2(-1, 0), from, head);
            vec4 b1 = read_or_zero(odd, down, from, head);
            vec4 b2 = read_or_zero(odd + 1, down, from, head);
            vec4 b3 = read_or_zero(odd, down + ivec2(1, 0), from, head);
            mat4 left = block(next, avatar);
            mat4 middle = block(next + 4, avatar);
            mat4 right = block(next + 8, avatar);
            sum0 += left * a0 + middle * a1 + right * a2;
            sum1 += left * a1 + middle * a2 + right * a3;
            sum2 += left * b0 + middle * b1 + right * b2;
            sum3 += left * b1 + middle * b2 + right * b3;
#ifdef LOCAL
            if (row == 1) {
                mat4 here = block(own, avatar);
                sum0 += here * a1;
                sum1 += here * a2;
                sum2 += here * b1;
                sum3 += here * b2;
                own += 4;
            }
#endif
            a0 = b0;
            a1 = b1;
            a2 = b2;
            a3 = b3;
            next += 12;
        }
    }
    value0 = IS_LEAKY == 1 ? leaky(sum0) : sum0;
    value1 = IS_LEAKY == 1 ? leaky(sum1) : sum1;
    value2 = IS_LEAKY == 1 ? leaky(sum2) : sum2;
    value3 = IS_LEAKY == 1 ? leaky(sum3) : sum3;
}

// A matrix for each avatar times a row for each head.

uniform sampler2D rows;

layout(location = 0) out vec4 value;

#include "decode.glsl"

void main() {
    ivec2 place = ivec2(gl_FragCoord.xy); // which four outputs, whose
    int avatar = avatar_of(place.y);
#ifdef BIAS
    value = number(BIAS + place.x, avatar);
#else
    value = vec4(0.0);
#endif
    int next = WEIGHTS + 4 * IN_VECTORS * place.x;
    for (int from = 0; from < IN_VECTORS; ++from) {
        value += block(next, avatar) * texelFetch(rows, ivec2(from, place.y), 0);
        next += 4;
    }
}
